# SPDX-License-Identifier: GPL-3.0-or-later
"""The order in which adapters transfer their data, and which of them run in parallel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from zoomout_core.runtime.progress import portion, renaming
from zoomout_core.runtime.threads import side_by_side

from .adapter import Adapter, Remarks, TransferJob

# Kinds that take about as long as all others together and do not depend on them.
LONG = ("shape_keys", "shape")


def transfer_all(adapters: Sequence[Adapter], job: TransferJob) -> None:
    """Transfer all data, shape keys in a thread beside the rest."""
    long = [one for one in adapters if one.kind in LONG]
    others = [one for one in adapters if one.kind not in LONG]
    if not (long and others):
        _in_turn(adapters, job)
        return
    # Separate remarks, so that their order does not depend on which thread is faster.
    aside = replace(job, remarks=Remarks())
    with renaming(lambda _: "Transferring"):
        side_by_side(partial(_in_turn, others, job), partial(_in_turn, long, aside))
    job.remarks.add(aside.remarks.notes)
    job.remarks.skipped.update(aside.remarks.skipped)


def _in_turn(adapters: Sequence[Adapter], job: TransferJob) -> None:
    for i, one in enumerate(adapters):
        with portion(i / len(adapters), (i + 1) / len(adapters)):
            one.transfer(job)
