# SPDX-License-Identifier: GPL-3.0-or-later
"""Set the landmarks of a face on a source with expression keys."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo

from .. import mesh_data
from ..scene.landmarks import set_landmark, surface_points_on
from .matching.propose_partners import propose_partners


def set_face_landmarks(context: Context, objects: Sequence[Object]) -> tuple[int, int]:
    """Set the landmarks of a face on the source, and propose them on the targets that it is matched with.

    Landmarks of the same names that are on the source already stay where they are.

    Args:
        context: Blender's; the objects are in its scene.
        objects: the source, then the targets.

    Returns:
        The numbers of landmarks that were set, and of places that were proposed.

    Raises:
        MeshError: the source lacks the keys, see `zoomout_core.propose_face_landmarks`; nothing was set.
    """
    source, scene = objects[0], context.scene
    offsets = mesh_data.read_full_offsets(source)
    if not offsets:
        raise zo.MeshError("'{name}' has no shape keys: add or transfer some first.", name=source.name)
    surface = mesh_data.read_surface_at_rest(source, positions=mesh_data.read_rest_positions(source.data))
    keys = mesh_data.offsets_of(tuple(offsets), np.stack(list(offsets.values()), axis=1))
    vertices = zo.propose_face_landmarks(surface, keys)
    depsgraph = context.evaluated_depsgraph_get()
    places = {name: mesh_data.surface_point_of_vertex(source, vertex, depsgraph) for name, vertex in vertices.items()}
    numbers = {landmark.name: landmark.number for landmark in scene.zoomout.landmarks}
    present = surface_points_on(scene, source)
    count = 0
    for name, place in places.items():
        number = numbers.setdefault(name, max(numbers.values(), default=0) + 1)
        if number not in present:
            set_landmark(scene, source, place, number, name)
            count += 1
    return count, propose_partners(context, objects, [numbers[name] for name in places])
