# SPDX-License-Identifier: GPL-3.0-or-later
"""Several cores at work: functions side by side, and a BLAS that does not fight over the cores meanwhile.

The products of a match are small. Threads of BLAS gain nothing on them, and where other programs keep the cores
busy they wait for each other, many times as long as the products take.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from contextvars import copy_context
from functools import partial, wraps
from numbers import Integral
from threading import Lock
from typing import Any, ParamSpec, TypeVar

import threadpoolctl
from threadpoolctl import threadpool_limits

from zoomout_core.runtime.progress import Strands, advance, portion

First = TypeVar("First")
Second = TypeVar("Second")
Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

# Seconds between two looks at an interrupt of the user while threads work: half of what users notice.
PATIENCE = 0.05
# Threads that work at a time, unless the user says otherwise: more wait for each other in a match.
MAX_THREADS = 8
VARIABLE = "ZOOMOUT_THREADS"


class _Cores:
    """So many threads work at a time; one that waits for others lends its core to them."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._free, self._mine = threading.Semaphore(count), threading.local()

    def run(self, work: Callable[[], Result]) -> Result:
        """Run a function once a core is free; returns its result."""
        with self._free:
            self._mine.held = True
            try:
                return work()
            finally:
                self._mine.held = False

    @contextmanager
    def lend(self) -> Iterator[None]:
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

    Example:
        >>> zo.set_threads(2)
        >>> zo.set_threads(None)  # as many as there are cores, up to 8
    """
    global _cores
    _cores = None if count is None else _Cores(_check("The number of threads", count))


def threads() -> int:
    """How many threads work at a time."""
    return _known_cores().count


def _known_cores() -> _Cores:
    global _cores
    if _cores is None:
        said = os.environ.get(VARIABLE)
        if said is None:
            _cores = _Cores(min(MAX_THREADS, usable_cores()))
        else:
            _cores = _Cores(_check(VARIABLE, int(said) if said.isdecimal() else said))
    return _cores


def holding_a_core(work: Callable[[], Result]) -> Result:
    """Call a function once fewer threads than `threads()` are at work."""
    return _known_cores().run(work)


def usable_cores() -> int:
    """Cores that this process may use; where the system does not tell, all."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _check(name: str, count: object) -> int:
    if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
        raise ValueError(f"{name} is {count!r}: give a whole number of 1 or more.")
    return int(count)


def side_by_side(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Call two functions in as many threads, and return their results."""
    works: tuple[Callable[[], Any], ...] = first, second
    of_first, of_second = _in_threads(works)
    return of_first, of_second


def for_each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Call a function for each item in several threads, and return the results in order."""
    return _in_threads([partial(function, item) for item in items])


def _in_threads(works: Sequence[Callable[[], Result]]) -> list[Result]:
    """Results of functions that run in threads; where one raises, the others end when they next report progress."""
    count = min(threads(), len(works))
    if count <= 1:
        results = []
        for number, work in enumerate(works):
            with portion(number / len(works), (number + 1) / len(works)):
                results.append(work())
                advance(1.0)
        return results
    cores, strands = _known_cores(), Strands(len(works))

    def run(number: int) -> Result:
        with strands.strand(number):
            result = works[number]()
            advance(1.0)
        return result

    pool = ThreadPoolExecutor(max_workers=count)
    futures = [pool.submit(copy_context().run, cores.run, partial(run, number)) for number in range(len(works))]
    try:
        with cores.lend():
            running = set(futures)
            while running:
                # In short waits, for an interrupt of the user reaches no thread that waits for long.
                ended, running = wait(running, PATIENCE, FIRST_EXCEPTION)
                if any(future.exception() for future in ended):
                    break
        for future in futures:
            if future.done():
                future.result()
        return [future.result() for future in futures]
    finally:
        strands.stop()
        pool.shutdown(wait=False, cancel_futures=True)


class _OneBlasThread:
    """A context in which BLAS uses one thread; the earlier number is restored when the last one leaves it."""

    def __init__(self) -> None:
        self._lock, self._entered, self._limits = Lock(), 0, ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            if self._entered == 0:
                _take_over_blas()
                self._limits.enter_context(threadpool_limits(1, user_api="blas"))
            self._entered += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._entered -= 1
            if self._entered == 0:
                _take_over_blas()
                self._limits.close()


def _take_over_blas() -> None:
    """Let the calling thread limit BLAS; since threadpoolctl 3.8 others than the first to do so are ignored."""
    clear = getattr(getattr(threadpoolctl, "OpenBLASController", None), "clear_controlling_thread", None)
    if clear is not None:
        clear(force=True)


one_blas_thread = _OneBlasThread()


def on_one_blas_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Keep BLAS to one thread while a function runs."""

    @wraps(function)
    def wrapper(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with one_blas_thread:
            return function(*args, **kwargs)

    return wrapper
