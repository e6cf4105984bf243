# SPDX-License-Identifier: GPL-3.0-or-later
"""The progress that a computation reports, for tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import zoomout_core as zo
from zoomout_core.runtime.progress import Progress, reporting

Result = TypeVar("Result")


def reports_of(work: Callable[[], Result]) -> tuple[Result, list[Progress]]:
    """Return the result of a computation and all its progress reports in order.

    Fractions are raw: a listener of `zo.progress` would get them clamped so that they never decrease. The computation
    runs in one thread, as the fractions of several threads arrive out of order.
    """
    reports: list[Progress] = []

    def report(fraction: float, title: str) -> None:
        reports.append(Progress(fraction, title or (reports[-1].stage if reports else "")))

    zo.set_threads(1)
    try:
        with reporting(report):
            return work(), reports
    finally:
        zo.set_threads(None)


def fractions_of(work: Callable[[], object]) -> list[float]:
    """Return the fractions that a computation reports, see `reports_of`."""
    return [report.fraction for report in reports_of(work)[1]]
