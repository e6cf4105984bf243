# SPDX-License-Identifier: GPL-3.0-or-later
"""Ambient progress: a computation reports its progress, and any listener may cancel it.

The current reporter is a context variable, so no function has to pass it on. Threads of the core run in a copy of the
context (`runtime/threads.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:  # the command line reports progress before numpy is imported
    import numpy as np
    from numpy.typing import NDArray

# For each candidate of a match, the most likely first, (s,) vertices of the target and (s,) their images on the source.
Outlines: TypeAlias = "tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]"


@dataclass(frozen=True)
class Progress:
    """Progress of a long computation.

    Attributes:
        fraction: part done, in [0, 1], never decreasing.
        stage: description of the current stage, for users.
        outlines: a first look at a match: rough images of its candidates, the most likely first, as from
            `MatchResult.outline`. Empty until a map is known; replaced while candidates are compared.

    Example:
        >>> zo.Progress(0.5, "Refining").fraction
        0.5
    """

    fraction: float
    stage: str
    outlines: Outlines = field(default=(), compare=False, repr=False)


class Cancelled(BaseException):
    """A computation was stopped at the user's request.

    Example:
        >>> issubclass(zo.Cancelled, Exception)  # `except Exception` does not catch it
        False
    """


# Takes the fraction of the current portion that is done, in [0, 1], and the stage; empty for the portion's own.
Report: TypeAlias = Callable[[float, str], None]


def _ignore(_fraction: float, _stage: str) -> None:
    """Nobody listens."""


_report: ContextVar[Report] = ContextVar("report", default=_ignore)
# Takes the outlines of a match; None if nobody listens.
_show: ContextVar[Callable[[Outlines], None] | None] = ContextVar("show", default=None)


def advance(fraction: float) -> None:
    """Report the fraction of the current stage or portion that is done, in [0, 1].

    Raises:
        Cancelled: the user asked to stop.
    """
    _report.get()(fraction, "")


def show_outlines(outlines: Callable[[], Outlines]) -> None:
    """Compute the outlines of a match and report them, if anybody listens.

    Raises:
        Cancelled: the user asked to stop.
    """
    show = _show.get()
    if show is not None:
        show(outlines())


def portion(start: float, end: float) -> AbstractContextManager[None]:
    """Map the progress of a block from [0, 1] to [start, end] of the enclosing one."""
    return stage("", start, end)


@contextmanager
def stage(title: str, start: float = 0.0, end: float = 1.0) -> Iterator[None]:
    """Name a block for users, and map its progress from [0, 1] to [start, end] of the enclosing one."""
    outer = _report.get()

    def report(fraction: float, inner: str) -> None:
        outer(start + (end - start) * fraction, inner or title)

    if title:
        report(0.0, "")
    with reporting(report):
        yield


@contextmanager
def reporting(report: Report) -> Iterator[None]:
    """Send the progress of a block to a function in place of the enclosing block's."""
    token = _report.set(report)
    try:
        yield
    finally:
        _report.reset(token)


@contextmanager
def renaming(rename: Callable[[str], str]) -> Iterator[None]:
    """Change the titles of the stages of a block."""
    outer = _report.get()

    def report(fraction: float, title: str) -> None:
        outer(fraction, rename(title) if title else "")

    with reporting(report):
        yield


@contextmanager
def progress(listener: Callable[[Progress], object]) -> Iterator[None]:
    """Call a listener with the `Progress` of all that is computed in a block.

    Args:
        listener: called by one thread at a time, not always the same one. An exception that it raises, such as
            `Cancelled`, ends the computation. Listeners of enclosing blocks are called as well.

    Example:
        >>> with zo.progress(lambda progress: None):  # receives Progress(fraction, stage) again and again
        ...     result = zo.match(source, target, k_final=30)
    """
    outer, outer_show, lock, reached = _report.get(), _show.get(), Lock(), Progress(0.0, "")

    def report(fraction: float, title: str) -> None:
        nonlocal reached
        with lock:
            fraction_reached = max(reached.fraction, min(1.0, fraction))
            reached = replace(reached, fraction=fraction_reached, stage=title or reached.stage)
            listener(reached)
        outer(fraction, title)

    def show(outlines: Outlines) -> None:
        nonlocal reached
        with lock:
            reached = replace(reached, outlines=outlines)
            listener(reached)
        if outer_show is not None:
            outer_show(outlines)

    token = _show.set(show)
    try:
        with reporting(report):
            yield
    finally:
        _show.reset(token)


def listening(listener: Callable[[Progress], object] | None) -> AbstractContextManager[None]:
    """`progress`, or a context that does nothing if there is no listener.

    Raises:
        TypeError: it cannot be called.
    """
    if not (listener is None or callable(listener)):
        raise TypeError(f"progress is a {type(listener).__name__}: give a function that takes a Progress, or None.")
    return nullcontext() if listener is None else progress(listener)


class Strands:
    """The progress of `count` parallel computations. The progress of the whole is their mean."""

    def __init__(self, count: int) -> None:
        self._outer, self._lock = _report.get(), Lock()
        self._fractions, self._stopped = [0.0] * count, False

    def stop(self) -> None:
        """Raise `Cancelled` in each computation when it next reports."""
        self._stopped = True

    def strand(self, number: int) -> AbstractContextManager[None]:
        """A block that is one of the computations; raises `Cancelled` where these were stopped before it began."""
        if self._stopped:
            raise Cancelled

        def report(fraction: float, title: str) -> None:
            if self._stopped:
                raise Cancelled
            with self._lock:
                self._fractions[number] = fraction
                mean = sum(self._fractions) / len(self._fractions)
            self._outer(mean, title)

        return reporting(report)
