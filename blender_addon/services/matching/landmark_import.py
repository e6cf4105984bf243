# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks from small vertex groups or empties with the same names on several objects."""

from __future__ import annotations

import numpy as np
from bpy.types import Context, Object
from mathutils import Vector

import zoomout_core as zo
from zoomout_core.matching.pair import MAX_LANDMARK_DISTANCE
from zoomout_core.messages import message
from zoomout_core.transfer.keys.key_words import COPY

from ...mesh_data import (
    SurfacePoint,
    evaluated_mesh,
    extent,
    nearest_surface_point,
    origin,
    positions_in_object,
    read_positions,
    read_weights,
)
from ...scene.landmarks import set_landmark

# Maximum spread of a vertex group that marks a point: standard deviation over the square root of the mesh's area.
MAX_SPREAD = 0.1
# Kinds of markers, in messages.
NOUNS = {"GROUPS": "small vertex groups", "EMPTIES": "empties"}


def import_landmarks(context: Context, objects: list[Object], what: str) -> int:
    """Set landmarks at markers with the same name on the source and a target; existing landmarks are moved.

    Args:
        context: Blender's; the objects are in its scene.
        objects: the source, then the targets.
        what: the kind of markers, a key of `NOUNS`.

    Returns:
        The number of landmarks.

    Raises:
        MeshError: no names match; nothing was set.
    """
    find = points_of_groups if what == "GROUPS" else points_of_empties
    found = {obj: find(context, obj, objects) for obj in objects}
    shared = [name for name in found[objects[0]] if any(name in found[target] for target in objects[1:])]
    if not shared:
        raise zo.MeshError(
            "'{name}' and the target have no {nouns} with matching names: give corresponding ones the same name.",
            name=objects[0].name,
            nouns=message(NOUNS[what]),
        )
    numbers = {landmark.name: landmark.number for landmark in context.scene.zoomout.landmarks}
    for name in shared:
        number = numbers.get(name) or max(numbers.values(), default=0) + 1
        numbers[name] = number
        for obj in objects:
            if name in found[obj]:
                set_landmark(context.scene, obj, found[obj][name], number, name)
    return len(shared)


def points_of_groups(context: Context, obj: Object, objects: list[Object]) -> dict[str, SurfacePoint]:
    """Centres of an object's vertex groups that are small enough to mark a place."""
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
            if np.sqrt(share @ ((positions - centre) ** 2).sum(axis=1)) <= MAX_SPREAD * size:
                centres[name] = Vector(centre)
    places = {
        name: nearest_surface_point(obj, centre, MAX_SPREAD * size, depsgraph) for name, centre in centres.items()
    }
    return {name: place for name, place in places.items() if place is not None}


def points_of_empties(context: Context, obj: Object, objects: list[Object]) -> dict[str, SurfacePoint]:
    """Surface points of empties that are the object's children, or near its surface and no child of other `objects`.

    Their names lack the number that Blender appends.
    """
    depsgraph = context.evaluated_depsgraph_get()
    with evaluated_mesh(obj, depsgraph) as (_, mesh):
        size = extent(mesh)
    places = {}
    for empty in context.scene.objects:
        if empty.type == "EMPTY" and (empty.parent is None or empty.parent not in objects or empty.parent == obj):
            reach = size if empty.parent == obj else MAX_LANDMARK_DISTANCE * size
            point = Vector(positions_in_object(obj, origin(empty)).tolist())
            place = nearest_surface_point(obj, point, reach, depsgraph)
            if place is not None:
                places[COPY.sub("", empty.name)] = place
    return places
