# SPDX-License-Identifier: GPL-3.0-or-later
"""Overhead of the collection engine: pairs per minute next to a loop, sleeping tasks, a graph of thousands of tasks."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import evenly
from benchmarks.tables import Record, Tables
from zoomout_core.collection.collection import match_collection
from zoomout_core.collection.dask_engine import OnDask, local_engine
from zoomout_core.collection.engine import Engine, Task
from zoomout_core.runtime.threads import set_threads

# Seconds that a simulated pair sleeps, as long as a pair of 5,000 vertices takes, and number of pairs.
NAP, NAPS = 2.0, 20
# Shapes of the large plan, and pairs of each.
PLANNED, NEIGHBOURS = 10_000, 4


def run(data: Path, max_count: int | None, planned: int = PLANNED) -> Tables:
    """Measure the engine.

    `throughput`: shapes of `faust_r` to a template, without prepared bases: by a loop over `zo.match` in one thread
    and in one per core, in one process, and in two. `overhead`: tasks that only sleep. `planned`: seconds
    and memory of a graph of many empty tasks.

    Args:
        data: the benchmark data.
        max_count: number of shapes; 25 if omitted.
        planned: shapes of the plan.
    """
    files = evenly(sorted((data / "faust_r").glob("*.off")), max_count or 25)
    return {
        "throughput": [_loop(files, 1), _loop(files, None), *(_collection(files, workers) for workers in (1, 2))],
        "overhead": [_naps(workers) for workers in (1, 2)],
        "planned": [_plan(planned)],
    }


def nap(seconds: float, *_: object) -> int:
    """A task that only sleeps."""
    time.sleep(seconds)
    return 0


def _loop(files: Sequence[Path], threads: int | None) -> Record:
    zo.forget_shapes()
    zo.store_shapes(None)
    set_threads(threads)
    began = time.perf_counter()
    for path in tqdm(files[1:], desc="loop", leave=False):
        zo.match(zo.read_surface(files[0]), zo.read_surface(path))
    seconds = time.perf_counter() - began
    set_threads(None)
    return _throughput("loop" if threads is None else "loop, 1 thread", len(files) - 1, seconds)


def _collection(files: Sequence[Path], workers: int) -> Record:
    zo.forget_shapes()
    with tempfile.TemporaryDirectory() as folder, local_engine(workers, retries=0) as engine:
        began = time.perf_counter()
        match_collection(files, folder, template=files[0], engine=engine, cache=Path(folder) / "cache", agree=False)
        seconds = time.perf_counter() - began
    return _throughput(f"collection, {workers} worker{'s' if workers > 1 else ''}", len(files) - 1, seconds)


def _throughput(way: str, pairs: int, seconds: float) -> Record:
    return {"way": way, "pairs": pairs, "seconds": seconds, "pairs a minute": 60 * pairs / seconds}


def _naps(workers: int) -> Record:
    with local_engine(workers, retries=0) as engine:
        began = time.perf_counter()
        _finish(engine, [Task(f"nap {number}", nap, (NAP,)) for number in range(NAPS)])
        seconds = time.perf_counter() - began
    return {
        "workers": workers,
        "tasks": NAPS,
        "seconds": seconds,
        "overhead %": 100 * (seconds * workers / NAP / NAPS - 1),
    }


def _plan(shapes: int) -> Record:
    """A graph of a number of shapes and their pairs, whose tasks do nothing."""
    tasks = [Task(f"prepare {number}", nap, (0.0,)) for number in range(shapes)]
    for number in range(shapes):
        for step in range(1, NEIGHBOURS + 1):
            other = (number + step) % shapes
            needed = f"prepare {number}", f"prepare {other}"
            tasks.append(Task(f"match {number} {other}", nap, (0.0,), needed))
    with local_engine(2, retries=0) as engine:
        assert isinstance(engine, OnDask)
        before, began, planned = _peak(), time.perf_counter(), None
        for _ in engine.as_completed(tasks):
            planned = planned or time.perf_counter() - began
        seconds = time.perf_counter() - began
    return {
        "shapes": shapes,
        "tasks": len(tasks),
        "planned after s": planned,
        "seconds": seconds,
        "ms a task": 1000 * seconds / len(tasks),
        "client and scheduler, MB": _peak() - before,
    }


def _peak() -> float:
    """Peak memory of this process, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _finish(engine: Engine, tasks: Sequence[Task]) -> None:
    for _ in engine.as_completed(tasks):
        pass
