# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of operators that run as in a window: steps, ticks of the timer, and cancelling."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import enumerate as running_threads
from time import perf_counter, process_time, sleep, thread_time
from unittest.mock import patch

import numpy as np

from blender_addon.jobs import Job, Work
from blender_addon.operators.base import modal_operator

# Seconds between two checks whether threads have ended.
LOOK = 0.002


@dataclass(frozen=True)
class Step:
    """A step of the window's thread: work up to the next `await`, or a wait for a computation.

    Attributes:
        stage: the text in the status bar meanwhile.
        clock: wall-clock seconds.
        thread: processor seconds of the window's thread.
        processor: processor seconds of all threads.
    """

    stage: str
    clock: float
    thread: float
    processor: float


@dataclass
class Watch:
    """The measurements of one operator.

    Attributes:
        steps: all steps; the last one, after the last `await`, mainly writes.
        ticks: seconds of each call of the timer, during which the window is blocked.
        closing: seconds of cancelling the job, if it was cancelled.
        trailing: seconds from then until the last thread ended.
    """

    steps: list[Step] = field(default_factory=list)
    ticks: list[float] = field(default_factory=list)
    closing: float = 0.0
    trailing: float = 0.0

    @property
    def seconds(self) -> float:
        """Seconds from the click to the end, without those between ticks."""
        return sum(self.ticks)

    @property
    def longest(self) -> Step:
        """The longest step except the last one."""
        return max(self.steps[:-1], key=lambda step: step.clock, default=self.steps[-1])

    @property
    def processor(self) -> float:
        """Processor seconds of all threads."""
        return sum(step.processor for step in self.steps)

    def of_stages(self) -> dict[str, tuple[float, float]]:
        """Wall-clock and processor seconds by stage."""
        stages: dict[str, tuple[float, float]] = {}
        for step in self.steps:
            clock, processor = stages.get(step.stage, (0.0, 0.0))
            stages[step.stage] = clock + step.clock, processor + step.processor
        return stages


def watch(operate: Callable[[], object], escape_after: float = float("inf")) -> Watch:
    """Call one modal operator, run it as in a window, and measure it.

    Args:
        operate: calls the operator.
        escape_after: seconds of work after which ESC is pressed.
    """
    seen = Watch()

    def in_ticks(coroutine: Work[str]) -> str:
        job = _TimedJob(coroutine, seen)
        others = set(running_threads())  # for example a progress bar's thread, which does not end
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
    """A job that records its steps."""

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
    """Wall-clock seconds, and processor seconds of this thread and of all threads."""
    return perf_counter(), thread_time(), process_time()
