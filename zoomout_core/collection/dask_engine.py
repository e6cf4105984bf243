# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine of Dask (Rocklin 2015), on one machine or many."""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing import resource_tracker
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

from zoomout_core.collection.engine import Done, Engine, Failure, InThisProcess, Task, attempt, sentence_of
from zoomout_core.runtime.child_process import child_environment, modules_of_python_in
from zoomout_core.runtime.extras import install_hint
from zoomout_core.runtime.progress import advance

# Seconds between two checks for finished tasks.
PATIENCE = 0.05
# Seconds within which a scheduler must answer.
CONNECTING = 20
# Seconds within which a finished result (megabytes at most) must arrive; it never does if its worker was lost.
ARRIVING = 60
# Tasks submitted to a cluster at a time: more than its workers, and few enough for its scheduler to keep up.
MAX_UNDER_WAY = 2000
# The first version of Python that can leave out the working folder.
SAFE_PATH_SINCE = (3, 11)
# Number of files, including connections, that a process opens for itself and for each worker. These are a third more
# than the 19 and 12 measured with 2, 4 and 8 workers.
OWN_FILES, FILES_PER_WORKER = 26, 16
# Where processes on this machine listen: other machines cannot connect.
LOOPBACK = "127.0.0.1"
LOST = "The connection to the scheduler was lost: finished pairs are kept, so run the same command again to resume."


class _Lost(Failure):
    """A task that was abandoned when its worker was lost, perhaps because of another task."""


class OnDask:
    """Tasks on the workers of a Dask cluster.

    Args:
        client: the cluster's `distributed.Client`.
        retries: how often to retry a task whose worker failed or was lost.
    """

    def __init__(self, client: Any, retries: int = 0) -> None:
        self._client, self._retries = client, retries

    def sees(self, paths: Sequence[Path]) -> bool:
        self._client.wait_for_workers(1, timeout=CONNECTING)
        there = self._client.run(_all_exist, [str(path.absolute()) for path in paths])
        return bool(there) and all(there.values())

    def as_completed(self, tasks: Sequence[Task]) -> Iterator[Done]:
        lost: set[str] = set()
        task_of = {task.key: task for task in tasks}
        for done in self._as_completed(tasks):
            if isinstance(done.result, _Lost):
                lost.add(done.key)
            else:
                yield done
        # Tasks that wait for a killed worker are lost with it, and the cluster does not know which one was at fault.
        failed: dict[str, Failure] = {}
        for task in tasks:
            if task.key in lost:
                yield from self._alone(task, task_of, failed)

    def _as_completed(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """`run_tasks`, with a `_Lost` for a task that was lost with its worker."""
        from distributed import as_completed

        run = uuid4().hex[:8]
        ahead = deque(_sort_by_need(tasks))
        uses = Counter(key for task in tasks for key in task.after)
        futures: dict[str, Any] = {}
        under_way: dict[str, str] = {}  # keys of tasks by the cluster's names
        waiting = as_completed(loop=self._client.loop)

        def release(key: str) -> None:
            if not uses[key] and futures[key].key not in under_way:
                del futures[key]

        while ahead or under_way:
            while ahead and len(under_way) < MAX_UNDER_WAY:
                task = ahead.popleft()
                needed = [futures[key] for key in task.after]
                future = self._client.submit(
                    attempt, task.function, *task.arguments, *needed, key=f"{task.key}-{run}", retries=self._retries
                )
                futures[task.key], under_way[future.key] = future, task.key
                waiting.add(future)
                for key in task.after:
                    uses[key] -= 1
                    release(key)
            ended = waiting.next_batch(block=False)
            for future in ended:
                key = under_way.pop(future.key)
                release(key)
                yield Done(key, self._result_of(future))
            if not ended:
                if self._client.status != "running":
                    raise ConnectionError(LOST)
                advance(0.0)  # so that a listener can cancel
                time.sleep(PATIENCE)

    def _alone(self, task: Task, task_of: Mapping[str, Task], failed: dict[str, Failure]) -> Iterator[Done]:
        """Retry a task alone; a failure is added to `failed`, by its key."""
        chain = [*_requirements(task, task_of), task]
        fault = next((failed[each.key] for each in chain if each.key in failed), None)
        if fault is not None:
            yield Done(task.key, fault)
            return
        for done in self._as_completed(chain):
            if isinstance(done.result, Failure):
                failed[done.key] = done.result
            if done.key == task.key:
                yield done

    def _result_of(self, future: Any) -> Any:
        if future.status == "finished":
            from distributed import TimeoutError as TimedOut

            try:
                return future.result(timeout=ARRIVING)
            except TimedOut:  # lost with its worker, such as when the machine slept
                return _Lost(sentence_of(None))
            except OSError as cut:  # of the connection: an error of the task is in its status
                raise ConnectionError(LOST) from cut
        error = future.exception() if future.status == "error" else None
        lost = error is None or type(error).__name__ == "KilledWorker"
        return (_Lost if lost else Failure)(sentence_of(error))


def _requirements(task: Task, task_of: Mapping[str, Task]) -> list[Task]:
    """All tasks that a task depends on."""
    found: dict[str, Task] = {}
    for key in task.after:
        for each in (*_requirements(task_of[key], task_of), task_of[key]):
            found[each.key] = each
    return list(found.values())


def _sort_by_need(tasks: Sequence[Task]) -> list[Task]:
    """Sort tasks so that dependencies come right before each task, and are soon released."""
    task_of = {task.key: task for task in tasks}
    ordered: dict[str, Task] = {}
    for task in sorted(tasks, key=lambda task: not task.after):
        for each in (*_requirements(task, task_of), task):
            ordered.setdefault(each.key, each)
    return list(ordered.values())


def _all_exist(paths: list[str]) -> bool:
    return all(Path(path).exists() for path in paths)


@contextmanager
def local_engine(workers: int, retries: int) -> Iterator[Engine]:
    """An engine on this machine: this process for one worker, otherwise a Dask cluster of one process per core.

    The processes listen on this machine only, and authenticate each other with certificates that are made for each
    cluster. Without this, anyone who can send a task to a worker can run any code as its user.

    Raises:
        ImportError: several workers were asked for, and Dask is not installed.
        OSError: the processes would import modules of the working folder instead of Python's, or they cannot be
            started, such as within a limit of open files.
    """
    if workers == 1:
        yield InThisProcess(retries)
        return
    distributed = _import_distributed(retries)
    import dask

    check_working_folder()
    check_open_files(workers)
    # Each process computes on a core of its own. By default, Dask returns the memory of every freed array to the system
    # at once, and requests it again. This takes 97 s of processor time instead of 61 (`benchmarks collection-engine`).
    alone = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "ZOOMOUT_THREADS"), "1")
    settings = {
        "distributed.nanny.pre-spawn-environ": alone,
        # Their HTTP servers cannot be turned off, but need not answer.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with (
        TemporaryDirectory(prefix="zoomout-", ignore_cleanup_errors=True) as folder,
        dask.config.set(settings),
        _environment(child_environment()),
        _cluster(
            lambda: distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host=LOOPBACK,
                dashboard_address=f"{LOOPBACK}:0",
                scheduler_kwargs={"dashboard": False},
                security=True,
                local_directory=folder,
                silence_logs=logging.CRITICAL,
            )
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield OnDask(client, retries)


@contextmanager
def _cluster(start: Callable[[], Any]) -> Iterator[Any]:
    """A cluster from a function that starts it, whose processes no interrupt reaches; leaving the context ends them.

    It is started in a thread that blocks interrupts. Otherwise, Ctrl-C would end processes that are being started, with
    tracebacks, and a cluster without them cannot be closed.

    Raises:
        OSError: the processes cannot be started.
    """
    with ThreadPoolExecutor(1, initializer=_block_interrupts) as thread:
        starting = thread.submit(start)
        try:
            try:
                cluster = starting.result()
            except (RuntimeError, TimeoutError) as error:
                raise OSError(
                    f"The processes could not be started ({error}): free memory and disk space, raise the limits of "
                    "this shell (ulimit), or use --workers 1."
                ) from error
            yield cluster
        finally:
            if starting.exception() is None:
                starting.result().close()


def _block_interrupts() -> None:
    """Block interrupts in this thread, and in the threads and processes that it starts."""
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # starting it would let interrupts through again
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])


def check_open_files(workers: int) -> None:
    """Check that this process may open the files for some workers; its own limit is raised if the system allows it.

    Raises:
        OSError: it may not.
    """
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    need = OWN_FILES + FILES_PER_WORKER * workers
    limit, highest = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit == resource.RLIM_INFINITY or limit >= need:
        return
    if highest != resource.RLIM_INFINITY and highest < need:
        fewer = max(1, (highest - OWN_FILES) // FILES_PER_WORKER)
        raise OSError(
            f"{workers} workers need {need} open files, but this shell allows {highest}: raise the limit (ulimit -n), "
            f"or use --workers {fewer}."
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (need, highest))


def has_dask() -> bool:
    """Whether several processes can be used."""
    return all(map(find_spec, ("distributed", "cryptography")))


def check_working_folder() -> None:
    """Check that new processes import nothing from the working folder; Python 3.10 cannot leave it out.

    Raises:
        OSError: it has modules with the names of Python's own.
    """
    if sys.version_info < SAFE_PATH_SINCE and (planted := modules_of_python_in(Path.cwd())):
        raise OSError(
            f"{planted[0]} in the current folder would replace a module of Python in each process: start the command "
            "in another folder, or use --workers 1."
        )


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """A context with environment variables, for all processes started in it; Dask adds those of its workers."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


@contextmanager
def remote_engine(address: str, retries: int) -> Iterator[Engine]:
    """An engine on the running Dask cluster of a scheduler's address, such as tcp://10.0.0.1:8786.

    Raises:
        ImportError: Dask is not installed.
        ConnectionError: there is no scheduler.
    """
    distributed = _import_distributed(retries)
    try:
        distributed.comm.get_address_host_port(address)  # a client of a wrong address could not be closed
        client = distributed.Client(address, timeout=CONNECTING, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f"There is no scheduler at {address} ({error}): check the address.") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECTING)
        except TimeoutError as error:
            raise ConnectionError(f"The scheduler at {address} has no workers: start some.") from error
        yield OnDask(client, retries)


def _import_distributed(retries: int) -> Any:
    """The package, configured so that a dying worker uses up one try of its task."""
    try:
        import cryptography  # noqa: F401, for certificates
        import dask
        import distributed
    except ImportError as error:
        raise ImportError(
            f"Using several processes requires Dask and cryptography: {install_hint('collections')}, or use "
            "--workers 1."
        ) from error
    dask.config.set({"distributed.scheduler.allowed-failures": retries})
    # Its log is about its own parts; failures are in the report.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    return distributed
