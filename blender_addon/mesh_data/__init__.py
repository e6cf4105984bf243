"""Blender's meshes as arrays, and arrays back onto meshes: the only place that converts between the two.

Whole arrays go through `foreach_get` and `foreach_set`.
"""

from .cutting import cut_mesh
from .layers import (
    MATCH_ATTRIBUTES,
    MOST_UV_MAPS,
    ActiveLayers,
    Layer,
    Role,
    data_without_a_way,
    fits,
    read_active_layers,
    read_layer,
    read_layers,
    write_active_layers,
    write_layer,
)
from .marks import MARKS, SEAMS, read_marks, write_marks
from .materials import read_materials, write_materials
from .normals import read_custom_normals, write_custom_normals
from .shape_keys import (
    ShapeKey,
    ShapeKeys,
    read_rest_positions,
    read_shape_keys,
    write_animation,
    write_shape,
    write_shape_keys,
)
from .surfaces import (
    directions_in_world,
    evaluated_mesh,
    is_flat,
    is_mirrored,
    positions_in_world,
    read_positions,
    read_source_surface,
    read_surface_at_rest,
    read_target_surface,
    to_object,
)
from .vertex_groups import deforming_bones, locked_groups, read_weights, write_weights

__all__ = [
    "MARKS",
    "MATCH_ATTRIBUTES",
    "MOST_UV_MAPS",
    "SEAMS",
    "ActiveLayers",
    "Layer",
    "Role",
    "ShapeKey",
    "ShapeKeys",
    "cut_mesh",
    "data_without_a_way",
    "deforming_bones",
    "directions_in_world",
    "evaluated_mesh",
    "fits",
    "is_flat",
    "is_mirrored",
    "locked_groups",
    "positions_in_world",
    "read_active_layers",
    "read_custom_normals",
    "read_layer",
    "read_layers",
    "read_marks",
    "read_materials",
    "read_positions",
    "read_rest_positions",
    "read_shape_keys",
    "read_source_surface",
    "read_surface_at_rest",
    "read_target_surface",
    "read_weights",
    "to_object",
    "write_active_layers",
    "write_animation",
    "write_custom_normals",
    "write_layer",
    "write_marks",
    "write_materials",
    "write_shape",
    "write_shape_keys",
    "write_weights",
]
