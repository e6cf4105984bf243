# SPDX-License-Identifier: GPL-3.0-or-later
"""Run functions on several cores, while BLAS uses one thread so that it does not compete for the cores.

The matrix products of a match are small, so BLAS threads gain nothing. If other programs keep the cores busy, these
threads wait for each other many times longer than the products take.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar, copy_context
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

# Seconds between two checks for a user's interrupt while threads work: half of what users notice.
PATIENCE = 0.05
# Default maximum of threads: with more, the threads of a match wait for each other.
MAX_THREADS = 8
VARIABLE = "ZOOMOUT_THREADS"


class _Cores:
    """Limits how many threads work at a time. A thread that waits for others lends them its core."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._free, self._mine = threading.Semaphore(count), threading.local()

    def run(self, work: Callable[[], Result]) -> Result:
        """Run a function as soon as a core is free; returns its result."""
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
_alone: ContextVar[bool] = ContextVar("alone", default=False)


def set_threads(count: int | None) -> None:
    """Set how many threads all computations may use from now on; results do not depend on it.

    Args:
        count: 1 or more; None for the environment variable ZOOMOUT_THREADS, or if it is not set, the number of cores
            that this process may use, at most 8.

    Raises:
        ValueError: the number is invalid.

    Example:
        >>> zo.set_threads(2)
        >>> zo.set_threads(None)  # as many as there are cores, up to 8
    """
    global _cores
    _cores = None if count is None else _Cores(_check("The number of threads", count))


def threads() -> int:
    """How many threads may work at a time."""
    return 1 if _alone.get() else _known_cores().count


@contextmanager
def in_one_thread() -> Iterator[None]:
    """A context whose computations use one thread, such as those that nobody waits for yet."""
    token = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(token)


def _known_cores() -> _Cores:
    global _cores
    if _cores is None:
        setting = os.environ.get(VARIABLE)
        if setting is None:
            _cores = _Cores(min(MAX_THREADS, usable_cores()))
        else:
            _cores = _Cores(_check(VARIABLE, int(setting) if setting.isdecimal() else setting))
    return _cores


def holding_a_core(work: Callable[[], Result]) -> Result:
    """Call a function as soon as fewer than `threads()` threads are at work."""
    return _known_cores().run(work)


def usable_cores() -> int:
    """Cores that this process may use; all if the system does not say."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _check(name: str, count: object) -> int:
    if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
        raise ValueError(f"{name} is {count!r}: give a whole number of 1 or more.")
    return int(count)


def side_by_side(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Call two functions in two threads, and return their results."""
    works: tuple[Callable[[], Any], ...] = first, second
    of_first, of_second = _in_threads(works)
    return of_first, of_second


def for_each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Call a function for each item in several threads, and return the results in order."""
    return _in_threads([partial(function, item) for item in items])


def _in_threads(works: Sequence[Callable[[], Result]]) -> list[Result]:
    """Results of functions that run in threads; if one raises, the others end when they next report progress."""
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
    try:
        futures = [_submit(pool, partial(cores.run, partial(run, number))) for number in range(len(works))]
        with cores.lend():
            running = set(futures)
            while running:
                # Wait briefly each time: a user's interrupt does not reach a thread during a wait.
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


def _submit(pool: ThreadPoolExecutor, work: Callable[[], Result]) -> Future[Result]:
    """Start a function in a pool, in the present context.

    Raises:
        MemoryError: there is no memory for the thread's stack, or the system has no more threads.
    """
    try:
        return pool.submit(copy_context().run, work)
    except RuntimeError as error:
        raise MemoryError(str(error)) from error


class _OneBlasThread:
    """A context in which BLAS uses one thread; the earlier number is restored when the last thread leaves it."""

    def __init__(self) -> None:
        self._lock, self._entered, self._limits = Lock(), 0, ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            if self._entered == 0:
                take_over_blas()
                self._limits.enter_context(threadpool_limits(1, user_api="blas"))
            self._entered += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._entered -= 1
            if self._entered == 0:
                take_over_blas()
                self._limits.close()


def take_over_blas() -> None:
    """Allow the calling thread to limit BLAS; since threadpoolctl 3.8 only the first thread to do so may."""
    clear = getattr(getattr(threadpoolctl, "OpenBLASController", None), "clear_controlling_thread", None)
    if clear is not None:
        clear(force=True)


one_blas_thread = _OneBlasThread()


def _after_fork() -> None:
    """Free the locks of threads that a child process does not have, such as those of a match during a fork."""
    global _cores
    _cores = None if _cores is None else _Cores(_cores.count)
    one_blas_thread.__init__()  # type: ignore[misc]


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)


def on_one_blas_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Keep BLAS to one thread while a function runs."""

    @wraps(function)
    def wrapper(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with one_blas_thread:
            return function(*args, **kwargs)

    return wrapper
