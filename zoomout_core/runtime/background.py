# SPDX-License-Identifier: GPL-3.0-or-later
"""Run one computation in a thread, for callers that must not wait, such as a user interface."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from contextvars import copy_context
from typing import Generic, TypeVar

from zoomout_core.runtime.progress import Cancelled, Progress, progress
from zoomout_core.runtime.threads import holding_a_core

Result = TypeVar("Result")


class Background(Generic[Result]):
    """A function that starts at once in its own thread, and that others poll; `progress` is the latest it reported."""

    def __init__(self, work: Callable[[], Result]) -> None:
        self.progress, self._cancelled = Progress(0.0, ""), False
        pool = ThreadPoolExecutor(max_workers=1)
        self._future = pool.submit(copy_context().run, self._run, work)
        pool.shutdown(wait=False)

    def wait(self, seconds: float) -> bool:
        """Wait for the result for at most some seconds; returns whether the function has ended."""
        return bool(wait([self._future], seconds).done)

    def result(self) -> Result:
        """Wait until the function has ended; return its result, or raise its exception."""
        return self._future.result()

    def cancel(self) -> None:
        """Raise `Cancelled` in the function when it next reports progress. The caller need not wait for that."""
        self._cancelled = True

    def _run(self, work: Callable[[], Result]) -> Result:
        with progress(self._listen):
            return holding_a_core(work)

    def _listen(self, latest: Progress) -> None:
        if self._cancelled:
            raise Cancelled
        self.progress = latest
