# SPDX-License-Identifier: GPL-3.0-or-later
"""Select the symmetry line of a mesh, and name its sides by vertex groups."""

from __future__ import annotations

import numpy as np
from bpy.types import Object
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.arrays import Booleans
from zoomout_core.messages import message, plural
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.transfer import Attribute, Domain, Kind

from ... import mesh_data
from ...properties.symmetry import LEFT_GROUP, MIDDLE_GROUP, RIGHT_GROUP
from ...storage import stored_symmetry


def select_symmetry_line(obj: Object) -> str:
    """Select only the vertices nearest to the symmetry line stored on an object's mesh.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or no line; nothing was selected.
    """
    symmetry = _with_sides(obj)
    chosen = vertices_on_line(symmetry)
    faces = np.zeros(len(obj.data.polygons), dtype=bool)
    with mesh_data.all_or_nothing(obj):
        mesh_data.write_selection(obj.data, Attribute("selection", Domain.POINT, Kind.BOOLEAN, chosen))
        mesh_data.write_selection(obj.data, Attribute("selection", Domain.FACE, Kind.BOOLEAN, faces))
        obj.data.update()
    return plural(
        int(chosen.sum()),
        "Selected 1 vertex on the symmetry line of '{name}'",
        "Selected {count:,} vertices on the symmetry line of '{name}'",
        name=obj.name,
    )


def vertices_on_line(symmetry: SelfMap) -> Booleans:
    """(n,) mask of the vertices on the line: the nearer end of each edge that it crosses."""
    ends = symmetry.surface.edges
    distance = symmetry.distance[ends]
    crossed = distance[:, 0] * distance[:, 1] <= 0
    nearer = np.where(np.abs(distance[:, 0]) <= np.abs(distance[:, 1]), ends[:, 0], ends[:, 1])
    chosen = np.zeros(len(symmetry.distance), dtype=bool)
    chosen[nearer[crossed & distance.any(axis=1)]] = True
    return chosen


def name_sides(obj: Object, width: float) -> str:
    """Make vertex groups of the sides of an object's mesh; they replace those of the same names.

    Args:
        obj: a mesh object.
        width: distance from the line to the edge of the middle, over the square root of the surface's area.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or it has no sides; nothing was written.
    """
    symmetry = _with_sides(obj)
    side = symmetry.sides(width * np.sqrt(symmetry.surface.area))
    members = np.column_stack([side > 0, side < 0, side == 0])
    weights = csr_array(members.astype(np.float32))
    with mesh_data.all_or_nothing(obj):
        mesh_data.write_weights(
            obj, Attribute("sides", Domain.POINT, Kind.WEIGHT, weights, (LEFT_GROUP, RIGHT_GROUP, MIDDLE_GROUP))
        )
        obj.data.update()
    left, right, middle = members.sum(axis=0)
    return message(
        "'{name}': {left} vertices on the left, {right} on the right, {middle} in the middle",
        name=obj.name,
        left=left,
        right=right,
        middle=middle,
    )


def _with_sides(obj: Object) -> SelfMap:
    symmetry = stored_symmetry.read(obj)
    if not symmetry.has_sides:
        raise zo.MeshError("This symmetry has no left and right side: choose a reflection.")
    return symmetry
