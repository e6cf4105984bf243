# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators at work as they are in a window, timed: steps, ticks of the timer, and what it takes to end them early."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import enumerate as running_threads
from time import perf_counter, process_time, sleep, thread_time
from unittest.mock import patch

import numpy as np

from blender_addon.jobs import Job, Work
from blender_addon.operators import modal_operator

# Seconds between two looks at whether threads have ended.
LOOK = 0.002


@dataclass(frozen=True)
class Step:
    """What the window's thread did in one go: a piece of work up to the next `await`, or a wait for a computation.

    Attributes:
        stage: as the status bar says meanwhile.
        clock: seconds.
        thread: seconds of the processor that the thread took which the window needs.
        processor: those of all threads.
    """

    stage: str
    clock: float
    thread: float
    processor: float


@dataclass
class Watch:
    """What an operator at work was seen to do.

    Attributes:
        steps: all of them; what comes after the last `await`, the writing above all, is the last one.
        ticks: seconds that each call of the timer took, which the window is not given back for.
        closing: seconds that it took to cancel the job, where that was done.
        trailing: seconds from then on until the last thread had ended.
    """

    steps: list[Step] = field(default_factory=list)
    ticks: list[float] = field(default_factory=list)
    closing: float = 0.0
    trailing: float = 0.0

    @property
    def seconds(self) -> float:
        """From the click to the end, but for what is done between ticks."""
        return sum(self.ticks)

    @property
    def longest(self) -> Step:
        """The longest step but the last one."""
        return max(self.steps[:-1], key=lambda step: step.clock, default=self.steps[-1])

    @property
    def processor(self) -> float:
        """Seconds of the processor that all threads took."""
        return sum(step.processor for step in self.steps)

    def of_stages(self) -> dict[str, tuple[float, float]]:
        """Seconds, and seconds of the processor, by stage."""
        stages: dict[str, tuple[float, float]] = {}
        for step in self.steps:
            clock, processor = stages.get(step.stage, (0.0, 0.0))
            stages[step.stage] = clock + step.clock, processor + step.processor
        return stages


def watch(operate: Callable[[], object], escape_after: float = float("inf")) -> Watch:
    """Call one modal operator, have it work as in a window, and watch it.

    Args:
        operate: the call.
        escape_after: seconds of work after which ESC ends it.
    """
    seen = Watch()

    def in_ticks(coroutine: Work[str]) -> str:
        job = _TimedJob(coroutine, seen)
        others = set(running_threads())  # a progress bar's, for example, which does not end
        while seen.seconds < escape_after:
            start = perf_counter()
            try:
                if job.advance(modal_operator.SLICE):
                    return job.result
            finally:
                seen.ticks.append(perf_counter() - start)
        start = perf_counter()
        job.cancel()
        seen.closing = perf_counter() - start
        while set(running_threads()) - others:
            sleep(LOOK)
        seen.trailing = perf_counter() - start - seen.closing
        return "Cancelled"

    with patch.object(modal_operator, "run", in_ticks):
        operate()
    return seen


class _TimedJob(Job[str]):
    """A job each of whose steps is noted."""

    def __init__(self, coroutine: Work[str], seen: Watch) -> None:
        super().__init__(coroutine)
        self._seen = seen

    def _is_ready(self, seconds: float) -> bool:
        with self._note():
            return super()._is_ready(seconds)

    def _step(self) -> bool:
        with self._note():
            return super()._step()

    @contextmanager
    def _note(self) -> Iterator[None]:
        stage, before = self.progress.stage, np.array(_clocks())
        try:
            yield
        finally:
            self._seen.steps.append(Step(stage, *(np.array(_clocks()) - before).tolist()))


def _clocks() -> tuple[float, float, float]:
    """Seconds of the clock, of the processor in this thread, and in all threads."""
    return perf_counter(), thread_time(), process_time()
