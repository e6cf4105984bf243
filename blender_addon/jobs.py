# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that keep the window responsive: coroutines on Blender's main thread, whose computations run in a thread.

`bpy` may be touched on the main thread only. A coroutine reads and writes there, and awaits what it computes from
arrays.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Coroutine, Generator, Iterator
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from dataclasses import replace
from time import monotonic
from typing import Any, Generic, TypeAlias, TypeVar, cast
from weakref import WeakMethod

from zoomout_core.runtime.background import Background
from zoomout_core.runtime.progress import Progress, progress

Result = TypeVar("Result")
# A coroutine yields a function for its runner to call, or None for a pause.
Work: TypeAlias = Coroutine[Callable[[], Any] | None, Any, Result]

# Seconds to wait for a computation before the window gets its turn: less than users notice.
WAIT = 0.02

_watch: ContextVar[Callable[[], object] | None] = ContextVar("watch", default=None)


@types.coroutine
def compute(work: Callable[[], Result]) -> Generator[Callable[[], Result], Any, Result]:
    """Call a function that does not touch `bpy`, in a thread if the coroutine runs as a `Job`.

    >>> result = await compute(partial(zo.match, source, target))
    """
    return cast(Result, (yield work))


@types.coroutine
def pause() -> Generator[None, Any, None]:
    """Let the window be redrawn between two pieces of work on the main thread.

    Objects and meshes may be edited or removed meanwhile: find them again afterwards.
    """
    yield None


@contextmanager
def watching(watch: Callable[[], object]) -> Iterator[None]:
    """Call a function on the main thread, again and again, while a `Job` waits for the computations of a block."""
    token = _watch.set(watch)
    try:
        yield
    finally:
        _watch.reset(token)


def run(coroutine: Work[Result]) -> Result:
    """Run a coroutine to its end in the calling thread, and return its result."""
    try:
        work = coroutine.send(None)
        while True:
            try:
                result = None if work is None else work()
            except BaseException as error:
                work = coroutine.throw(error)
            else:
                work = coroutine.send(result)
    except StopIteration as finished:
        return cast(Result, finished.value)


class Job(Generic[Result]):
    """A coroutine that advances in slices on the main thread, while its computations run in a thread.

    Args:
        coroutine: the coroutine to run.

    Attributes:
        progress: the latest progress reported.
        result: the coroutine's return value, once it has finished.
    """

    result: Result

    def __init__(self, coroutine: Work[Result]) -> None:
        self.progress = Progress(0.0, "Starting")
        self._given, self._running = coroutine, _run_reporting(coroutine, WeakMethod(self._listen))
        self._context = copy_context()
        self._background: Background[Any] | None = None

    def advance(self, seconds: float) -> bool:
        """Work for some seconds, or until it waits for a computation; returns whether the coroutine has finished.

        Unless it waits, it gets at least to its next `compute` or `pause`. Exceptions of the coroutine are raised here.
        """
        end = monotonic() + seconds
        while True:
            if not self._is_ready(min(max(end - monotonic(), 0), WAIT)):
                if (watch := self._context.get(_watch)) is not None:
                    self._context.run(watch)
                return False
            if self._step():
                return True
            if monotonic() >= end:
                return False

    def cancel(self) -> None:
        """Close the coroutine without waiting; its computation ends when it next reports progress."""
        if self._background is not None:
            self._background.cancel()
            self._background = None
        self._context.run(self._running.close)
        self._given.close()  # in case it has not begun

    def __del__(self) -> None:
        # Otherwise the coroutine would be closed in another context, which contextvars reject.
        self.cancel()

    def _is_ready(self, seconds: float) -> bool:
        """Wait up to some seconds for a computation; returns whether the coroutine can go on."""
        return self._background is None or self._background.wait(seconds)

    def _step(self) -> bool:
        """Go on to the next `compute` or `pause`; returns whether the coroutine has finished."""
        background, self._background = self._background, None
        try:
            work = self._context.run(self._proceed, background)
        except StopIteration as finished:
            self.result = finished.value
            return True
        if work is not None:
            self._background = self._context.run(Background, work)
        return False

    def _proceed(self, background: Background[Any] | None) -> Callable[[], Any] | None:
        try:
            result = None if background is None else background.result()
        except BaseException as error:
            return self._running.throw(error)
        return self._running.send(result)

    def _listen(self, latest: Progress) -> None:
        self.progress = replace(latest, stage=latest.stage or self.progress.stage)


async def _run_reporting(coroutine: Work[Result], listener: WeakMethod[Callable[[Progress], None]]) -> Result:
    """Run a coroutine and report its progress to a job.

    The reference to the job is weak, so that a dropped job is deleted at once, which cancels it.
    """

    def listen(latest: Progress) -> None:
        if (tell := listener()) is not None:
            tell(latest)

    with progress(listen):
        return await coroutine
