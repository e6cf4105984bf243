# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the add-on's coroutines as in a window, one turn after another."""

from collections.abc import Iterator
from typing import Any

from blender_addon.jobs import Job
from zoomout_core.runtime.progress import Progress

# Seconds after which a computation counts as stuck.
STUCK = 600


def turns(job: Job[Any]) -> Iterator[Progress]:
    """Run a job to its end; yields at each pause and each computation, when the window gets its turn."""
    while True:
        if job._background is not None:
            assert job._background.wait(STUCK)
        if job.advance(0):
            return
        yield job.progress


def finish(job: Job[Any]) -> Any:
    """Run a job to its end and return its result."""
    for _ in turns(job):
        pass
    return job.result
