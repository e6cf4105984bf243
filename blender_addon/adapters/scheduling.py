"""The order in which adapters transfer their data, and which of them run in parallel."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace

from zoomout_core.runtime.stepping import Steps, spread, within
from zoomout_core.runtime.threads import side_by_side

from .adapter import Adapter, Remarks, TransferJob

# Kinds that take about as long as all others together and do not depend on them.
LONG = ("shape_keys", "shape")


def transfer_all_steps(adapters: Sequence[Adapter], job: TransferJob) -> Steps[None]:
    """Transfer all data, shape keys in a thread beside the rest."""
    long = [one for one in adapters if one.kind in LONG]
    others = [one for one in adapters if one.kind not in LONG]
    if not (long and others):
        yield from _in_turn(adapters, job)
        return
    # Remarks of their own, so that their order does not depend on who is faster.
    aside = replace(job, remarks=Remarks())
    both = side_by_side(_fractions(others, job), _fractions(long, aside))
    yield from spread(both, 0, 1, "Transferring")
    job.remarks.add(aside.remarks.notes)
    job.remarks.skipped.update(aside.remarks.skipped)


def _in_turn(adapters: Sequence[Adapter], job: TransferJob) -> Steps[None]:
    for i, one in enumerate(adapters):
        yield from within(one.transfer(job), i / len(adapters), (i + 1) / len(adapters))


def _fractions(adapters: Sequence[Adapter], job: TransferJob) -> Generator[float, None, None]:
    for progress in _in_turn(adapters, job):
        yield progress.fraction
