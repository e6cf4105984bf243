# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of an object in another shape."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.types import Context, Object
from mathutils import Matrix

from zoomout_core.arrays import Floats

from ..surfaces.surfaces import VERTEX_PRESERVING, is_mirrored


def add_shaped_copy(context: Context, obj: Object, name: str, shape: Floats, place: Floats) -> Object:
    """Add a copy of an object with its own mesh, in the object's collections.

    It has no shape keys, parent, constraints, animation or deforming modifiers, but the object's groups, materials and
    attributes.

    Args:
        context: Blender's.
        obj: the object to copy.
        name: name of the new object.
        shape: (n, 3) positions in world space.
        place: (3,) its origin.
    """
    place = place.astype(np.float32)  # as Blender stores it
    copy = obj.copy()
    copy.data = obj.data.copy()
    copy.name = copy.data.name = name
    copy.animation_data_clear()
    copy.shape_key_clear()
    copy.parent = None
    for constraint in list(copy.constraints):
        copy.constraints.remove(constraint)
    for modifier in [modifier for modifier in copy.modifiers if modifier.type in VERTEX_PRESERVING]:
        copy.modifiers.remove(modifier)
    if is_mirrored(obj):  # its new matrix does not flip faces
        copy.data.flip_normals()
    copy.data.vertices.foreach_set("co", np.ascontiguousarray(shape - place, np.float32).ravel())
    copy.data.update()
    for collection in obj.users_collection or (context.scene.collection,):
        collection.objects.link(copy)
    copy.select_set(False)
    copy.delta_location, copy.delta_scale = (0, 0, 0), (1, 1, 1)
    copy.delta_rotation_euler, copy.delta_rotation_quaternion = (0, 0, 0), (1, 0, 0, 0)
    copy.matrix_world = Matrix.Translation(place.tolist())
    context.view_layer.update()
    return bpy.data.objects[copy.name]
