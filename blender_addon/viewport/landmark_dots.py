# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks in the 3D view: numbered dots on the source and the targets."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import Any

import blf
import bpy
import gpu
import numpy as np
from bpy.types import Context, Object, Region, RegionView3D, SpaceView3D
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

import zoomout_core as zo

from ..scene.landmarks import surface_points_on
from ..scene.selection import participants

# In pixels, at an interface scale of 1.
RADIUS, RING, TEXT = 8.0, 2.0, 11
ACTIVE_RING, OTHER_RING = (1.0, 1.0, 1.0, 1.0), (0.05, 0.05, 0.05, 1.0)
TEXT_COLOR = (0.0, 0.0, 0.0, 1.0)
# Colour of a dot whose landmark has no partner.
ALONE = (0.55, 0.55, 0.55)
# Inside of a proposed dot, and the width of its coloured ring.
PROPOSED, PROPOSED_RING = (0.92, 0.92, 0.92, 1.0), 3.0
# Hues in steps of the golden ratio differ for any number of landmarks.
GOLDEN = 0.618034
SEGMENTS = 24

_handle: Any = None


@dataclass(frozen=True)
class Dot:
    """A landmark in a view.

    Attributes:
        number: number of the landmark.
        obj: the object with the landmark.
        place: (2,) in the view's region, in pixels.
        paired: whether the other side has the landmark, too, if only as a proposal.
        active: whether it is chosen in the list.
        proposed: whether a match proposed the place.
    """

    number: int
    obj: Object
    place: Vector
    paired: bool
    active: bool
    proposed: bool = False


def register() -> None:
    """Start to draw landmarks."""
    global _handle
    _handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Stop drawing landmarks."""
    bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")


def dots(context: Context, region: Region, view: RegionView3D, space: SpaceView3D) -> list[Dot]:
    """The landmarks of the source and the targets in a view."""
    settings = context.scene.zoomout
    try:
        source, targets = participants(context)
    except zo.MeshError:  # without a source there are no pairs
        return []
    active = settings.active_landmark
    number = settings.landmarks[active].number if active < len(settings.landmarks) else None
    on_source = surface_points_on(context.scene, source, proposed=True)
    on_targets = {target: surface_points_on(context.scene, target, proposed=True) for target in targets}
    on_any = set().union(*on_targets.values())
    depsgraph = context.evaluated_depsgraph_get()
    found = []
    for obj, places in ((source, on_source), *on_targets.items()):
        if not (places and obj.visible_get() and (space.local_view is None or obj.local_view_get(space))):
            continue
        evaluated, own = obj.evaluated_get(depsgraph), surface_points_on(context.scene, obj)
        for one, place in places.items():
            position = place.on(evaluated.data)
            if position is None:  # the face is unknown, as in Edit Mode
                position = Vector(place.position)
            pixel = location_3d_to_region_2d(region, view, evaluated.matrix_world @ position)
            if pixel is not None:
                paired = one in (on_any if obj == source else on_source)
                found.append(Dot(one, obj, pixel, paired, one == number, one not in own))
    return found


def color_of(number: int) -> tuple[float, float, float]:
    """The colour of a landmark's dots, light enough for dark letters."""
    return colorsys.hsv_to_rgb(GOLDEN * number % 1, 0.55, 1.0)


def dot_at(shown: list[Dot], place: Vector, scale: float) -> Dot | None:
    """The dot under the mouse, the topmost of several."""
    return next((dot for dot in reversed(shown) if (dot.place - place).length <= (RADIUS + RING) * scale), None)


def _draw() -> None:
    context = bpy.context
    space = context.space_data
    if not (context.scene.zoomout.show_landmarks and space.overlay.show_overlays):
        return
    scale = context.preferences.system.ui_scale
    shown = dots(context, context.region, context.region_data, space)
    if shown:
        _draw_discs(shown, scale)
        _draw_numbers(shown, scale)


def _draw_discs(shown: list[Dot], scale: float) -> None:
    angle = np.linspace(0, 2 * np.pi, SEGMENTS + 1)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    fan = np.stack([np.zeros((SEGMENTS, 3)), circle[:-1], circle[1:]], axis=1).reshape(-1, 3)  # triangles
    positions, colors = [], []
    for dot in shown:
        ring = ACTIVE_RING if dot.active else OTHER_RING
        inside = (*(color_of(dot.number) if dot.paired else ALONE), 1.0)
        discs = [(RADIUS + RING, ring), (RADIUS, inside)]
        if dot.proposed:
            discs.append((RADIUS - PROPOSED_RING, PROPOSED))
        for radius, color in discs:
            positions.append(fan * radius * scale + (*dot.place, 0.0))
            colors.append(np.tile(color, (len(fan), 1)))
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    values = {name: np.concatenate(rows).astype(np.float32) for name, rows in (("pos", positions), ("color", colors))}
    gpu.state.blend_set("ALPHA")
    batch_for_shader(shader, "TRIS", values).draw(shader)
    gpu.state.blend_set("NONE")


def _draw_numbers(shown: list[Dot], scale: float) -> None:
    font = 0
    blf.size(font, TEXT * scale)
    blf.color(font, *TEXT_COLOR)
    for dot in shown:
        text = str(dot.number)
        width, height = blf.dimensions(font, text)
        blf.position(font, dot.place.x - width / 2, dot.place.y - height / 2, 0)
        blf.draw(font, text)
