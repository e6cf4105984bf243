"""Long work as generators: they yield `Progress` and return their result, and whoever drains them may stop."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Progress:
    """How far a long computation has come.

    Attributes:
        fraction: part done, in [0, 1], never falling.
        stage: what is being done, in words for the user.
    """

    fraction: float
    stage: str


Steps: TypeAlias = Generator[Progress, None, Result]


def drain(steps: Generator[object, None, Result]) -> Result:
    """Run a stepped computation to its end and return its result."""
    while True:
        try:
            next(steps)
        except StopIteration as finished:
            return finished.value


def spread(steps: Generator[float, None, Result], start: float, end: float, stage: str) -> Steps[Result]:
    """Report the fractions that a part yields as progress of the whole, from `start` to `end`."""
    inner: Iterator[float] = scaled(steps, start, end)
    while True:
        try:
            fraction = next(inner)
        except StopIteration as finished:
            return finished.value
        yield Progress(min(end, fraction), stage)


def within(steps: Steps[Result], start: float, end: float) -> Steps[Result]:
    """A computation as a part of a longer one: its progress runs from `start` to `end`."""
    while True:
        try:
            progress = next(steps)
        except StopIteration as finished:
            return finished.value
        yield Progress(start + (end - start) * progress.fraction, progress.stage)


def scaled(steps: Generator[float, None, Result], start: float, end: float) -> Generator[float, None, Result]:
    """A part of a longer computation that yields fractions, its own running from `start` to `end`."""
    while True:
        try:
            fraction = next(steps)
        except StopIteration as finished:
            return finished.value
        yield start + (end - start) * fraction
