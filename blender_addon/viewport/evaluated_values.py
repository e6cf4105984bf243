# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of overlays on evaluated meshes with other vertices, such as subdivided or mirrored ones.

The modifiers themselves compute them on a copy, which is impossible while Blender draws the views. So they are
requested then, computed when Blender is idle, and cached until the object's modifiers change.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

import bpy
from bpy.types import Object

from zoomout_core.arrays import Floats

from ..mesh_data import values_through_modifiers
from ..scene.redraw import redraw_views


class _EvaluatedValues(NamedTuple):
    """Values after the modifiers; None if these lose them."""

    of: Floats
    state: Hashable
    values: Floats | None


# Computed and requested values, by the `session_uid` of objects.
_known: dict[int, _EvaluatedValues] = {}
_wanted: dict[int, Floats] = {}


def values_on(obj: Object, evaluated: Object, values: Floats) -> Floats | None:
    """Values of an object's own vertices (n, 3) or corners (c, 2), on those of its evaluated mesh.

    None if they are not known yet, in which case the views are redrawn once they are, or cannot be computed.
    """
    counts = [len(mesh.vertices if values.shape[1] == 3 else mesh.loops) for mesh in (obj.data, evaluated.data)]
    if len(values) == counts[1]:
        return values
    if len(values) != counts[0]:
        return None
    known = _known.get(obj.session_uid)
    if known is None or known.of is not values or known.state != _state(obj, evaluated):
        _wanted[obj.session_uid] = values
        if not (bpy.app.background or bpy.app.timers.is_registered(_tick)):
            bpy.app.timers.register(_tick, first_interval=0)
        return None
    return known.values


def is_lost(obj: Object) -> bool:
    """Whether the modifiers of an object are known to lose values."""
    known = _known.get(obj.session_uid)
    return known is not None and known.values is None


def compute_requested() -> None:
    """Compute the requested values."""
    while _wanted:
        uid, values = _wanted.popitem()
        obj = next((one for one in bpy.context.view_layer.objects if one.session_uid == uid), None)
        if obj is None or obj.mode != "OBJECT":
            continue
        depsgraph = bpy.context.evaluated_depsgraph_get()
        state = _state(obj, obj.evaluated_get(depsgraph))
        _known[uid] = _EvaluatedValues(values, state, values_through_modifiers(obj, depsgraph, values))


def clear() -> None:
    """Clear computed and requested values."""
    _known.clear()
    _wanted.clear()


def _tick() -> None:
    """Compute requested values and redraw; Blender calls this when it is idle."""
    compute_requested()
    redraw_views()


def _state(obj: Object, evaluated: Object) -> Hashable:
    """A state that changes when the modifiers produce another mesh."""
    made = len(evaluated.data.vertices), len(evaluated.data.loops)
    return made, tuple((modifier.name, modifier.type, modifier.show_viewport) for modifier in obj.modifiers)
