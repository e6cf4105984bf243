# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror the displacement of vertices since the symmetry was detected."""

from __future__ import annotations

from functools import partial

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.messages import message, plural
from zoomout_core.runtime.progress import stage
from zoomout_core.symmetry.mirror import Direction
from zoomout_core.symmetry.offsets import symmetrise_offsets

from ... import mesh_data
from ...jobs import compute, pause, run
from ...scene.pair import name_of
from ...storage import stored_symmetry
from .mesh_access import READING, writable_mesh, writing


def mirror_sculpt(context: Context, obj: Object, direction: Direction = "left_to_right") -> str:
    """Mirror the displacement of vertices since the symmetry of an object's mesh was detected.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        direction: see `zoomout_core.symmetry.mirror.symmetrise`.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or no vertex was moved; nothing was written.
    """
    return run(mirror_sculpt_async(context, name_of(obj), direction))


async def mirror_sculpt_async(context: Context, name: str, direction: Direction) -> str:
    """`mirror_sculpt` as a coroutine, which keeps no Blender data across an `await`."""
    obj = writable_mesh(context, name)
    symmetry, moved = stored_symmetry.read_with_sculpt(obj)
    if not moved.any():
        raise zo.MeshError(_why_nothing_moved(obj))
    with stage(READING, 0, 0):
        await pause()
    now = symmetry.surface.with_vertices(symmetry.surface.vertices + moved)
    with stage("Mirroring the sculpt"):
        wanted = await compute(partial(symmetrise_offsets, moved, symmetry, direction))
    with writing(context, name, now) as obj:
        mesh_data.move_vertices(obj.data, wanted - moved)
        stored_symmetry.store_shape(obj)
    count = int((np.abs(wanted - moved) > 1e-6 * np.abs(moved).max()).any(axis=1).sum())
    return plural(
        count,
        "Mirrored the sculpt of '{name}': 1 vertex moved",
        "Mirrored the sculpt of '{name}': {count:,} vertices moved",
        name=name,
    )


def _why_nothing_moved(obj: Object) -> str:
    """The reason why no vertices of an object were moved, and the remedy."""
    levels = [modifier.name for modifier in obj.modifiers if modifier.type == "MULTIRES"]
    if levels:
        return message(
            "No vertex of '{name}' was moved since its symmetry was detected: the sculpt is stored "
            "in the levels of '{modifier}', so use its Apply Base first.",
            name=obj.name,
            modifier=levels[0],
        )
    if obj.data.shape_keys and obj.active_shape_key_index > 0:
        return message(
            "No vertex of '{name}' was moved since its symmetry was detected: the sculpt is stored "
            "in the active shape key, so use Mirror Shape Key.",
            name=obj.name,
        )
    return message(
        "No vertex of '{name}' was moved since its symmetry was detected: sculpt it, or mirror a shape key.",
        name=obj.name,
    )
