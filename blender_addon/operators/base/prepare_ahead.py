# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepare the selected source and target for a match while Blender is idle, and nothing else runs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import bpy
from bpy.types import Context, Mesh

import zoomout_core as zo

from ... import services
from ...jobs import Job
from ...mesh_data.surfaces.base_mesh import keeps_vertices
from ...properties.preferences import prepares_ahead
from ...scene.landmarks import OF_LANDMARKS
from ...scene.selection import source_name
from . import activity

# Seconds from a change of the selection to the preparation, and between two slices of that.
PAUSE, TICK = 0.5, 0.05
# Larger meshes take longer to read than the main thread may pause.
MAX_VERTICES = 200_000


class _Pair(NamedTuple):
    """The objects and options of a match."""

    source: str
    target: str
    options: tuple[tuple[str, Any], ...]
    meshes: tuple[int, int]  # `session_uid` of both


_latest: _Pair | None = None  # prepared last, or in preparation
_job: Job[None] | None = None


def consider() -> None:
    """Prepare the selected meshes, after a pause; called after each change of the scene."""
    if prepares_ahead(bpy.context) and not (bpy.app.background or bpy.app.timers.is_registered(_tick)):
        bpy.app.timers.register(_tick, first_interval=PAUSE)


def forget(meshes: Iterable[Mesh]) -> None:
    """Stop preparing meshes that are edited; they are prepared again afterwards."""
    if _latest is not None and not {mesh.session_uid for mesh in meshes}.isdisjoint(_latest.meshes):
        stop()


def stop() -> None:
    """Stop preparing; finished shapes are kept."""
    global _job, _latest
    if _job is not None:
        _job.cancel()
    _job = _latest = None


def clear() -> None:
    """Stop, and do not begin again before the next change."""
    stop()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)


def _tick() -> float | None:
    """Continue to prepare the selected meshes; returns the seconds until Blender calls this again."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window):
        return TICK if advance(bpy.context) else None


def advance(context: Context) -> bool:
    """Prepare the selected meshes, for a slice; returns whether to go on."""
    global _job, _latest
    pair = None if activity.running else _selected_pair(context)
    if pair != _latest:
        stop()
        if pair is not None:
            _latest, _job = pair, Job(_prepare(context, pair))
    job, _job = _job, None  # a job that fails is not advanced again
    try:
        if job is None or job.advance(0):
            return False
    except zo.MeshError:  # the match will report it
        return False
    _job = job
    return True


async def _prepare(context: Context, pair: _Pair) -> None:
    await services.load()
    options = dict(pair.options)
    await services.matching.prepare_ahead.prepare_ahead(context, pair.source, pair.target, **options)


def _selected_pair(context: Context) -> _Pair | None:
    """The surfaces that a match of the active object would need.

    None without two meshes in Object Mode, or if they are large. Also None if the target's modifiers add vertices:
    reading it would add a temporary copy to the scene, which the user has not asked for.
    """
    target, options = context.active_object, context.scene.zoomout.match_options()
    if target is None or target.type != "MESH" or target.mode != "OBJECT" or options["initial"] not in OF_LANDMARKS:
        return None
    try:
        source = context.scene.objects.get(source_name(context, target))
    except zo.MeshError:
        return None
    if source is None or source.type != "MESH" or source.data == target.data or not keeps_vertices(target):
        return None
    meshes = source.data, target.data
    if max(len(mesh.vertices) for mesh in meshes) > MAX_VERTICES:
        return None
    sizes = tuple((name, options[name]) for name in ("detail", "k_final"))
    return _Pair(source.name, target.name, sizes, tuple(mesh.session_uid for mesh in meshes))
