# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of the last transfer, stored on the target's mesh as a custom property."""

from __future__ import annotations

import json
from typing import Any

from bpy.types import Mesh, Object

from zoomout_core.messages import to_json

from .stored_json import Kind, is_of_kind, read_json

PROPERTY = "zoomout_report"
# The entries of a report; those of earlier versions lack the ones that may be None.
ENTRIES: dict[str, Kind] = {
    "source": str,
    "others": [str],
    "target": str,
    "written": dict,
    "skipped": dict,
    "notes": [str],
    "vertices": int,
    "low_confidence": int,
    "stretched": (None, str),
    "bound": (None, {"armature": str}),
}


def write(target: Object, report: dict[str, Any]) -> None:
    """Store a report; it replaces an earlier one."""
    target.data[PROPERTY] = json.dumps(to_json(report))


def remove(mesh: Mesh) -> None:
    """Remove the report from a mesh, if it has one."""
    if PROPERTY in mesh:
        del mesh[PROPERTY]


def transfer_report(target: Object) -> dict[str, Any] | None:
    """The report of the last transfer to an object, or None before the first.

    Returns:
        `source` and `target`: names of the objects; `written`: lists of names for each of `DATA`; `skipped`: a reason
        for each name; `notes`: sentences for the user; `vertices` and `low_confidence`: the number of the target's
        vertices, and of those of low confidence; `without_partner`: the fractions of the target's and of the source's
        area without a partner, if known; `bound`: None, or the name of the `armature` that the target was bound to, and
        its `shape`, see `Binding`.
    """
    stored = read_json(target.data, PROPERTY, ENTRIES)
    if stored is None or not all(is_of_kind(names, [str]) for names in stored["written"].values()):
        return None
    return stored
