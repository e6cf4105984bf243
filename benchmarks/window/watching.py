"""Operators at work as they are in a window, timed: steps, ticks of the timer, and what it takes to end them early."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from threading import enumerate as running_threads
from time import perf_counter, process_time, sleep, thread_time
from unittest.mock import patch

import numpy as np

from blender_addon.operators import stepped
from zoomout_core.runtime.stepping import Progress, Steps

# What is done before the first step, which names it.
BEGINNING = "Beginning"
# Seconds between two looks at whether threads have ended.
LOOK = 0.002


@dataclass(frozen=True)
class Step:
    """What was done between two looks at the generator.

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
        steps: all of them; what comes after the last yield, the writing above all, is the last one.
        ticks: seconds that each call of the timer took, which runs steps for a fixed time.
        closing: seconds that it took to close the generator, where that was done.
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


def watched(operate: Callable[[], object], escape_after: float = float("inf")) -> Watch:
    """Call one stepped operator, have it work as in a window, and watch it.

    Args:
        operate: the call.
        escape_after: seconds of work after which ESC ends it.
    """
    seen = Watch()

    def in_ticks(steps: Steps[str]) -> str:
        timed = _timed(steps, seen)
        others = set(running_threads())  # a progress bar's, for example, which does not end
        while seen.seconds < escape_after:
            start = perf_counter()
            try:
                stepped.work_for(timed, stepped.SLICE)
            except StopIteration as finished:
                return str(finished.value)
            finally:
                seen.ticks.append(perf_counter() - start)
        start = perf_counter()
        timed.close()
        seen.closing = perf_counter() - start
        while set(running_threads()) - others:
            sleep(LOOK)
        seen.trailing = perf_counter() - start - seen.closing
        return "Cancelled"

    with patch.object(stepped, "drain", in_ticks):
        operate()
    return seen


def _clocks() -> tuple[float, float, float]:
    """Seconds of the clock, of the processor in this thread, and in all threads."""
    return perf_counter(), thread_time(), process_time()


def _timed(steps: Steps[str], seen: Watch) -> Generator[Progress, None, str]:
    """The same steps, each of which is noted."""
    stage = BEGINNING
    try:
        while True:
            before = np.array(_clocks())
            try:
                progress = next(steps)
            except StopIteration as finished:
                return str(finished.value)
            finally:
                seen.steps.append(Step(stage, *(np.array(_clocks()) - before).tolist()))
            yield progress
            stage = progress.stage
    finally:
        steps.close()
