# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about meshes for the sidebar, computed when Blender is idle and cached until an edit."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
from bpy.types import Mesh, Object

from ..jobs import Job, run
from ..mesh_data import MeshFacts, inspect_mesh
from .redraw import redraw_views

# Seconds from a request to the inspection of meshes, and between two slices of that.
PAUSE, TICK = 0.3, 0.02

# Known facts, those before the latest edits, requested facts and number of edits, by the `session_uid` of meshes.
_known: dict[int, MeshFacts] = {}
_latest: dict[int, MeshFacts] = {}
_wanted: dict[int, None] = {}
_edits: dict[int, int] = {}
_job: Job[None] | None = None


def facts(obj: Object) -> MeshFacts | None:
    """The facts about an object's mesh, or None if not known yet; then the views are redrawn once they are."""
    number = obj.data.session_uid
    if number not in _known and obj.mode == "OBJECT":
        _wanted[number] = None
        if not (bpy.app.background or bpy.app.timers.is_registered(_tick)):
            bpy.app.timers.register(_tick, first_interval=PAUSE)
    return _known.get(number)


def latest_facts(obj: Object) -> MeshFacts | None:
    """The facts about an object's mesh. Until they are known, those before its last edit, so that no text flickers."""
    return facts(obj) or _latest.get(obj.data.session_uid)


def forget(meshes: Iterable[Mesh]) -> None:
    """Drop cached facts of meshes that may have been edited."""
    for mesh in meshes:
        number = mesh.session_uid
        _known.pop(number, None)
        _edits[number] = _edits.get(number, 0) + 1


def forget_all() -> None:
    """Clear the cache, and stop a running inspection."""
    global _job
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    if _job is not None:
        _job.cancel()
        _job = None
    for cache in (_known, _latest, _wanted, _edits):
        cache.clear()


def inspect_now() -> None:
    """Inspect all requested meshes."""
    run(_inspections())


def _tick() -> float | None:
    """Continue to inspect meshes; returns the seconds until Blender calls this again."""
    global _job
    job, _job = _job or Job(_inspections()), None  # a job that fails is not advanced again
    if job.advance(0):
        redraw_views()
        return None
    _job = job
    return TICK


async def _inspections() -> None:
    while _wanted:
        number, _ = _wanted.popitem()
        mesh = next((mesh for mesh in bpy.data.meshes if mesh.session_uid == number), None)
        if mesh is None or mesh.is_editmode:
            continue
        before = _edits.get(number, 0)
        found = await inspect_mesh(mesh)
        if _edits.get(number, 0) == before:
            _known[number] = _latest[number] = found
