"""Show by colours which places of the active mesh correspond to each other, and take such colours away."""

from __future__ import annotations

from functools import partial

import numpy as np
from bpy.types import Context, Object

from zoomout_core.arrays import Floats
from zoomout_core.progress import Progress, Steps, spread
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.threads import in_background

from ... import stored_symmetry, symmetry_preview
from ..stepped import SteppedOperator
from .base import SymmetryOperator, unedited, writable_mesh

# Colours of the right side are mixed with so much white, so that the line shows.
PALENESS = 0.35
# How far round the circle of hues heights go, and how much darker the places are that lie farthest apart.
HUES, DARKNESS = 0.8, 0.7
WHAT = "Places of the same color correspond; the right side is paler"


class ZOOMOUT_OT_preview_symmetry(SymmetryOperator):
    bl_idname = "zoomout.preview_symmetry"
    bl_label = "Show Symmetry"
    bl_description = (
        "Show by colors which places of the active mesh correspond: they have the same color, paler on the right"
    )
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        name = context.active_object.name
        symmetry = stored_symmetry.read(writable_mesh(context, name))
        colouring = in_background(partial(symmetry_colours, symmetry))
        colours = yield from spread(colouring, 0, 1, "Colouring")
        obj = unedited(context, name, symmetry.surface)
        symmetry_preview.show(context, obj.data, colours, WHAT)
        return WHAT


class ZOOMOUT_OT_remove_preview(SteppedOperator):
    bl_idname = "zoomout.remove_preview"
    bl_label = "Hide Symmetry"
    bl_description = "Take away the colors that show a symmetry, or how much is asymmetric; nothing of them is left"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active mesh shows such colours."""
        if not super().poll(context):
            return False
        if not symmetry_preview.is_shown(context.active_object.data):
            cls.poll_message_set("The active mesh shows no such colors")
            return False
        return True

    def steps(self, context: Context) -> Steps[str]:
        obj = writable_mesh(context, context.active_object.name)
        yield Progress(0.0, "Removing")
        symmetry_preview.remove(context, obj.data)
        return f"'{obj.name}' shows its own colors again"


def show_symmetry(context: Context, obj: Object) -> None:
    """Colour an object's mesh so that corresponding places have the same colour.

    Raises:
        MeshError: its symmetry is not known, or not any more.
    """
    symmetry_preview.show(context, obj.data, symmetry_colours(stored_symmetry.read(obj)), WHAT)


def symmetry_colours(symmetry: SelfMap) -> Floats:
    """(n, 3) colours: a hue for how high a place lies, darker the farther it is from its image; the right is paler.

    Height is that of the left one of a place and its image, along the longest side of the bounding box; where there
    are no sides, that of their middle.
    """
    places = symmetry.surface.vertices
    used = places[symmetry.surface.triangles.ravel()]
    low, extent = used.min(axis=0), np.ptp(used, axis=0)
    images = symmetry.surface_map.interpolate(places)
    right = symmetry.distance[:, None] < 0
    shown = np.where(right, images, places) if symmetry.has_sides else (places + images) / 2
    longest = int(np.argmax(extent))
    height = np.nan_to_num(np.clip((shown - low)[:, longest] / extent[longest], 0, 1))
    apart = np.nan_to_num(np.linalg.norm(images - places, axis=1))
    light = 1 - DARKNESS * apart / max(apart.max(initial=0), 1e-30)
    colours = light[:, None] * _hue(HUES * height)
    return np.where(right, PALENESS + (1 - PALENESS) * colours, colours)


def _hue(hue: Floats) -> Floats:
    """(n, 3) pure colours of hues (n,) from 0, red, over green and blue to 1, red again."""
    return np.clip(np.abs((6 * hue[:, None] + [0, 4, 2]) % 6 - 3) - 1, 0, 1)
