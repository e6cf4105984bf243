"""Places of landmarks from what objects have by name: small vertex groups, empties."""

from __future__ import annotations

import numpy as np
from bpy.types import Context, Object
from mathutils import Vector

from zoomout_core.matching.pair import OFF_SURFACE

from ..mesh_data import SurfacePoint, evaluated_mesh, extent, nearest_surface_point, read_positions, read_weights
from .name_matching import COPY

# Largest spread of a vertex group that marks a point: the standard deviation over the square root of the mesh's area.
MOST_SPREAD = 0.1


def points_of_groups(context: Context, obj: Object, objects: list[Object]) -> dict[str, SurfacePoint]:
    """Where an object's vertex groups are, those that are small enough to mark a place."""
    depsgraph = context.evaluated_depsgraph_get()
    with evaluated_mesh(obj, depsgraph) as (evaluated, mesh):
        weights = read_weights(evaluated, mesh)
        positions, size = read_positions(mesh).astype(float), extent(mesh)
    centres = {}
    for column, name in enumerate(weights.labels):
        of_group = weights.values[:, [column]].toarray()[:, 0]
        if of_group.sum() > 0:
            share = of_group / of_group.sum()
            centre = share @ positions
            if np.sqrt(share @ ((positions - centre) ** 2).sum(axis=1)) <= MOST_SPREAD * size:
                centres[name] = Vector(centre)
    places = {
        name: nearest_surface_point(obj, centre, MOST_SPREAD * size, depsgraph) for name, centre in centres.items()
    }
    return {name: place for name, place in places.items() if place is not None}


def points_of_empties(context: Context, obj: Object, objects: list[Object]) -> dict[str, SurfacePoint]:
    """Where on an object the empties are that are its children, or that lie near its surface and nobody else's child.

    They are named without the number that Blender appends.
    """
    depsgraph = context.evaluated_depsgraph_get()
    with evaluated_mesh(obj, depsgraph) as (_, mesh):
        size = extent(mesh)
    inverse = obj.matrix_world.inverted_safe()
    places = {}
    for empty in context.scene.objects:
        if empty.type == "EMPTY" and (empty.parent is None or empty.parent not in objects or empty.parent == obj):
            reach = size if empty.parent == obj else OFF_SURFACE * size
            place = nearest_surface_point(obj, inverse @ empty.matrix_world.translation, reach, depsgraph)
            if place is not None:
                places[COPY.sub("", empty.name)] = place
    return places
