# SPDX-License-Identifier: GPL-3.0-or-later
"""Engines run each task after its dependencies; a failed task does not stop unrelated ones."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
from creatures import creature

from zoomout_core.collection import dask_engine
from zoomout_core.collection.collection import match_collection
from zoomout_core.collection.dask_engine import OnDask, local_engine, remote_engine
from zoomout_core.collection.engine import Engine, Failure, InThisProcess, Task, run_tasks
from zoomout_core.collection.tasks import place_of_map
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.memory import NotEnoughMemoryError
from zoomout_core.runtime.progress import Cancelled, Progress, advance, progress, stage
from zoomout_core.runtime.threads import threads


def add(*numbers: int) -> int:
    with stage("adding"):
        advance(0.5)
    return sum(numbers)


def fail(*_: int) -> int:
    raise ValueError("It is not a number.")


def fail_at_first(marks: Path, error: type[Exception] = NotEnoughMemoryError) -> int:
    marks.write_text(marks.read_text() + "x" if marks.exists() else "x")
    if len(marks.read_text()) < 2:
        raise error("There is not enough memory.")
    return len(marks.read_text())


def die() -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def read_settings() -> tuple[str | None, str | None, int]:
    return os.environ.get("MALLOC_TRIM_THRESHOLD_"), os.environ.get("OPENBLAS_NUM_THREADS"), threads()


def results(engine: Engine, tasks: list[Task]) -> dict[str, object]:
    return {done.key: done.result for done in engine.as_completed(tasks)}


CHAIN = [
    Task("one", add, (1,)),
    Task("wrong", fail, (1,)),
    Task("three", add, (2,), ("one",)),
    Task("after wrong", add, (2,), ("one", "wrong")),
]
EXPECTED = {
    "one": 1,
    "wrong": Failure("It is not a number."),
    "three": 3,
    "after wrong": Failure("It is not a number."),
}


@pytest.fixture(scope="module")
def cluster() -> Iterator[Engine]:
    pytest.importorskip("distributed")
    with local_engine(2, retries=1) as engine:
        yield engine


def test_tasks_in_this_process_run_after_their_dependencies() -> None:
    assert results(InThisProcess(), CHAIN) == EXPECTED


def title_of(ended: int) -> str:
    return f"{ended} of {len(CHAIN)}"


def test_progress_of_tasks_is_reported_under_the_overall_title() -> None:
    told: list[Progress] = []
    with progress(told.append):
        assert {done.key: done.result for done in run_tasks(InThisProcess(), CHAIN, title_of)} == EXPECTED
    assert told[0] == Progress(0, "0 of 4")
    assert Progress(0.125, "0 of 4") in told  # halfway through the first task
    assert told[-1] == Progress(1, "4 of 4")
    assert [one.fraction for one in told] == sorted(one.fraction for one in told)
    assert {one.stage for one in told} == {title_of(ended) for ended in range(5)}


def test_task_in_this_process_can_be_cancelled_halfway() -> None:
    def listen(latest: Progress) -> None:
        if latest.fraction > 0.5:  # within the third task
            raise Cancelled

    ended = []
    with pytest.raises(Cancelled), progress(listen):
        ended += [done.key for done in run_tasks(InThisProcess(retries=1), CHAIN, title_of)]
    assert ended == []


def test_no_tasks_report_no_progress() -> None:
    with progress(pytest.fail):
        assert list(run_tasks(InThisProcess(), [], title_of)) == []


def test_waiting_for_a_cluster_can_be_cancelled(cluster: Engine) -> None:
    began = monotonic()

    def listen(latest: Progress) -> None:
        if monotonic() > began + 0.5:
            raise Cancelled

    with pytest.raises(Cancelled), progress(listen):
        list(run_tasks(cluster, [Task("sleeping", sleep, (30,))], title_of))
    assert monotonic() < began + 10


@pytest.mark.parametrize("error", [MemoryError, NotEnoughMemoryError, OSError])
@pytest.mark.parametrize(("retries", "expected"), [(0, "not enough memory"), (1, 2)])
def test_temporary_failures_are_retried(tmp_path: Path, retries: int, expected: object, error: type[Exception]) -> None:
    task = Task("a", fail_at_first, (tmp_path / "marks", error))
    (result,) = results(InThisProcess(retries), [task]).values()
    assert result == expected or (isinstance(result, Failure) and str(expected) in result.message)


def test_dask_runs_the_same_tasks(cluster: Engine, tmp_path: Path) -> None:
    again = Task("again", fail_at_first, (tmp_path / "marks",))
    assert results(cluster, [*CHAIN, again]) == {**EXPECTED, "again": 2}
    # Keys of an earlier run may be used again.
    assert results(cluster, CHAIN) == EXPECTED


def test_cluster_receives_a_few_tasks_at_a_time(cluster: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_engine, "MAX_UNDER_WAY", 3)
    parts = [Task(f"part {number}", add, (number,)) for number in range(10)]
    sums = [Task(f"sum {i}", add, (), (f"part {i}", f"part {(i + 1) % 10}")) for i in range(10)]
    found = results(cluster, [*parts, *sums, Task("all", add, (), tuple(task.key for task in sums))])
    assert len(found) == 21
    assert [found[f"sum {i}"] for i in range(10)] == [*range(1, 18, 2), 9]
    assert found["all"] == 90


def test_workers_use_one_thread_each(cluster: Engine) -> None:
    assert results(cluster, [Task("settings", read_settings, ())]) == {"settings": (None, "1", 1)}


def test_killed_worker_fails_only_its_own_task(cluster: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(cluster, OnDask)
    monkeypatch.setattr(
        cluster._client.cluster.scheduler, "allowed_failures", 0
    )  # another worker takes seconds to start
    found = results(cluster, [Task("dying", die, ()), *CHAIN])
    died = found.pop("dying")
    assert isinstance(died, Failure)
    assert "was killed" in died.message
    assert found == EXPECTED


def test_result_lost_with_its_worker_is_not_awaited() -> None:
    distributed = pytest.importorskip("distributed")

    class Gone:
        key, status = "gone", "finished"

        def result(self, timeout: float) -> int:
            raise distributed.TimeoutError

    assert "worker was lost" in OnDask(None)._result_of(Gone()).message


def test_cluster_checks_whether_workers_see_files(cluster: Engine, tmp_path: Path) -> None:
    assert cluster.sees([tmp_path])
    assert not cluster.sees([tmp_path / "missing"])


def test_missing_scheduler_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(dask_engine, "CONNECTING", 0.5)
    with pytest.raises(ConnectionError, match="check the address"), remote_engine("tcp://127.0.0.1:9", retries=0):
        pass


@pytest.mark.slow
def test_workers_and_this_process_give_equal_maps(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    files = [tmp_path / f"{seed}.ply" for seed in range(2)]
    for seed, file in enumerate(files):
        write_shape(creature(700, seed=seed, bend=0.3 * seed, asymmetry=0.3).surface, file)
    found = []
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        with local_engine(workers, retries=0) as engine:
            (pair,) = match_collection(files, folder, pairs=[("0", "1")], engine=engine).records
        found.append(np.load(folder / place_of_map(pair)))
    assert all(np.array_equal(found[0][name], found[1][name]) for name in found[0].files if name != "record")
