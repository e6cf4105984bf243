# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of a match or a binding that users can select and see."""

from __future__ import annotations

from bpy.types import Object

from zoomout_core.arrays import Booleans

from ..storage.stored_match import unpack_mask
from ..storage.stored_report import transfer_report

# Kinds of faults of a match.
DOUBTFUL, FLIPPED, TORN, WITHOUT_PARTNER = "doubtful", "flipped", "torn", "without_partner"


def stretched_vertices(target: Object) -> Booleans | None:
    """(n,) the vertices that stretch when the bones of the target's rig rotate; None if they are not known."""
    report = transfer_report(target)
    return None if report is None else unpack_mask(report.get("stretched"), len(target.data.vertices))
