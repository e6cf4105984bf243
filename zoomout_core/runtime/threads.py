"""Several cores at work: steps side by side, and a BLAS that does not fight over the cores meanwhile.

The products of a match are small. Threads of BLAS gain nothing on them, and where other programs keep the cores
busy they wait for each other, many times as long as the products take.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from functools import wraps
from numbers import Integral
from threading import Lock
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

from zoomout_core.runtime.stepping import scaled

First = TypeVar("First")
Second = TypeVar("Second")
Yielded = TypeVar("Yielded")
Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

# Seconds after which the caller has the word again, though no step has ended: half of what users notice.
PATIENCE = 0.05
# Threads that work at a time, unless the user says otherwise: on more the steps of a match wait for each other.
MOST_THREADS = 8
VARIABLE = "ZOOMOUT_THREADS"


class _Cores:
    """So many threads work at a time; one that waits for others lends its core to them."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._free, self._mine = threading.Semaphore(count), threading.local()

    def taken(self, work: Callable[[], Result]) -> Result:
        """What a function returns, run once a core is free."""
        with self._free:
            self._mine.held = True
            try:
                return work()
            finally:
                self._mine.held = False

    @contextmanager
    def lent(self) -> Iterator[None]:
        """A context in which the calling thread waits."""
        if not getattr(self._mine, "held", False):
            yield
            return
        self._free.release()
        try:
            yield
        finally:
            self._free.acquire()


_cores: _Cores | None = None


def set_threads(count: int | None) -> None:
    """Set how many threads work at a time from now on, in all computations; results do not depend on it.

    Args:
        count: of 1 or more; None for what the environment variable ZOOMOUT_THREADS says, or else as many as there are
            cores that this process may use, up to 8.

    Raises:
        ValueError: it is no such number.
    """
    global _cores
    _cores = None if count is None else _Cores(_checked("The number of threads", count))


def threads() -> int:
    """How many threads work at a time."""
    return _known_cores().count


def _known_cores() -> _Cores:
    global _cores
    if _cores is None:
        said = os.environ.get(VARIABLE)
        if said is None:
            _cores = _Cores(min(MOST_THREADS, usable_cores()))
        else:
            _cores = _Cores(_checked(VARIABLE, int(said) if said.isdecimal() else said))
    return _cores


def usable_cores() -> int:
    """Cores that this process may use; where the system does not tell, all."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _checked(name: str, count: object) -> int:
    if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
        raise ValueError(f"{name} is {count!r}: give a whole number of 1 or more.")
    return int(count)


def side_by_side(
    first: Generator[float, None, First], second: Generator[float, None, Second]
) -> Generator[float, None, tuple[First, Second]]:
    """Run two stepped computations in as many threads; the caller never waits long, however long their steps are.

    numpy and scipy let go of the interpreter in long operations. Closed halfway, it waits for nothing: the steps that
    are under way end by themselves, and nothing follows them.

    Yields:
        The fraction done.

    Returns:
        What the two return.
    """
    results = yield from _in_threads((first, second))
    return results[0], results[1]


def for_each(function: Callable[[Item], Result], items: Sequence[Item]) -> Generator[float, None, list[Result]]:
    """What a function returns for each item, by several threads in turns; yields the fraction done."""
    return (yield from for_each_stepped(lambda item: _single_step(lambda: function(item)), items))


def for_each_stepped(
    steps: Callable[[Item], Generator[float, None, Result]], items: Sequence[Item]
) -> Generator[float, None, list[Result]]:
    """What a stepped computation returns for each item, by several threads in turns; yields the fraction done."""
    results: list[Any] = [None] * len(items)
    strands = max(1, min(threads(), len(items)))

    def strand(first: int) -> Generator[float, None, None]:
        mine = range(first, len(items), strands)
        for count, i in enumerate(mine):
            results[i] = yield from scaled(steps(items[i]), count / len(mine), (count + 1) / len(mine))
            yield (count + 1) / len(mine)

    yield from _in_threads([strand(first) for first in range(strands)])
    return results


def alone(steps: Generator[float, None, Result]) -> Generator[float, None, Result]:
    """Run a stepped computation in a thread, so that the caller has the word again soon however long its steps are."""
    (result,) = yield from _in_threads((steps,))
    return result


def in_background(work: Callable[[], Result]) -> Generator[float, None, Result]:
    """Run a function that takes long in a thread; yields 0 now and then, and returns what it returns."""
    return (yield from alone(_single_step(work)))


def _single_step(work: Callable[[], Result]) -> Generator[float, None, Result]:
    yield from ()
    return work()


def _in_threads(computations: Sequence[Generator[float, None, Any]]) -> Generator[float, None, list[Any]]:
    fractions, results = [0.0] * len(computations), [None] * len(computations)
    running: dict[Future[float], int] = {}
    cores = _known_cores()

    def submit(number: int) -> Future[float]:
        return pool.submit(cores.taken, lambda: next(computations[number]))

    pool = ThreadPoolExecutor(max_workers=len(computations))
    try:
        running = {submit(number): number for number in range(len(computations))}
        while running:
            with cores.lent():
                ended = wait(running, PATIENCE, FIRST_COMPLETED).done
            for future in ended:
                number = running.pop(future)
                try:
                    fractions[number] = future.result()
                    running[submit(number)] = number
                except StopIteration as finished:
                    fractions[number], results[number] = 1.0, finished.value
            yield sum(fractions) / len(fractions)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for future, number in running.items():
            # A generator cannot be closed while it runs.
            future.add_done_callback(lambda _, steps=computations[number]: steps.close())  # type: ignore[misc]
    return results


class _OneBlasThread:
    """A context in which BLAS keeps to one thread; what was before is back when the last to enter it has left."""

    def __init__(self) -> None:
        self._lock, self._entered, self._limits = Lock(), 0, ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            if self._entered == 0:
                self._limits.enter_context(threadpool_limits(1, user_api="blas"))
            self._entered += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._entered -= 1
            if self._entered == 0:
                self._limits.close()


one_blas_thread = _OneBlasThread()


def on_one_blas_thread(
    steps: Callable[Arguments, Generator[Yielded, None, Result]],
) -> Callable[Arguments, Generator[Yielded, None, Result]]:
    """Keep BLAS to one thread from the first step of a stepped computation until it ends or is closed."""

    @wraps(steps)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Generator[Yielded, None, Result]:
        with one_blas_thread:
            return (yield from steps(*args, **kwargs))

    return limited
