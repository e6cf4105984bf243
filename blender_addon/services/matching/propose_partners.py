# SPDX-License-Identifier: GPL-3.0-or-later
"""Propose the places of landmarks that only one of two matched objects has, by the map between them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np
from bpy.types import Context, Object
from mathutils import Vector

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.pair import MAX_LANDMARK_DISTANCE

from ...jobs import run
from ...mesh_data import ObjectPair, evaluated_mesh, extent, nearest_surface_point, positions_in_object
from ...scene.landmarks import set_landmark, surface_points_on, world_positions
from ...scene.stored_pair import read_stored_match
from ...storage import stored_match
from ...storage.stored_match import StoredMatch


def propose_partners(context: Context, objects: Sequence[Object], numbers: Collection[int]) -> int:
    """Propose the partners of landmarks, by the match stored on each target.

    Nothing is proposed if both objects have the landmark, there is no valid match of the two, or the match finds no
    partner. Earlier proposals of these landmarks are replaced.

    Args:
        context: Blender's; the objects are in its scene.
        objects: the source, then the targets.
        numbers: numbers of the landmarks.

    Returns:
        The number of places that were proposed.
    """
    source, *targets = objects
    return sum(_propose(context, source, target, numbers) for target in targets)


def _propose(context: Context, source: Object, target: Object, numbers: Collection[int]) -> int:
    on_source, on_target = (surface_points_on(context.scene, obj).keys() & set(numbers) for obj in (source, target))
    found = _valid_match(context, source, target) if on_source != on_target else None
    if found is None:
        return 0
    return _place(context, source, on_source - on_target, target, partners_on_target, *found) + _place(
        context, target, on_target - on_source, source, partners_on_source, *found
    )


def _valid_match(context: Context, source: Object, target: Object) -> tuple[ObjectPair, StoredMatch] | None:
    """The stored match of these two objects, if it is valid."""
    if stored_match.description(target.data) is None:
        return None
    try:
        pair, match = run(read_stored_match(context, target.name))
    except zo.MeshError:  # one of them was edited since
        return None
    return (pair, match) if source.name in pair.source_names else None


def _place(
    context: Context,
    known: Object,
    numbers: Collection[int],
    other: Object,
    partners: Callable[[ObjectPair, StoredMatch, Floats], tuple[Floats, Booleans]],
    pair: ObjectPair,
    match: StoredMatch,
) -> int:
    """Propose places on `other` for landmarks on `known`; returns their number."""
    depsgraph = context.evaluated_depsgraph_get()
    places = surface_points_on(context.scene, known)
    positions = world_positions(known, {number: places[number] for number in numbers}, depsgraph)
    there = {number: position for number, position in positions.items() if position is not None}
    if not there:
        return 0
    points, valid = partners(pair, match, np.array(list(there.values())))
    with evaluated_mesh(other, depsgraph) as (_, mesh):
        most = MAX_LANDMARK_DISTANCE * extent(mesh)
    count, own = 0, positions_in_object(other, points[valid])
    for number, point in zip(np.array(list(there))[valid].tolist(), own.tolist(), strict=True):
        place = nearest_surface_point(other, Vector(point), most, depsgraph)
        if place is not None:
            set_landmark(context.scene, other, place, number, proposed=True)
            count += 1
    return count


def partners_on_source(pair: ObjectPair, match: StoredMatch, points: Floats) -> tuple[Floats, Booleans]:
    """Images (q, 3) on the source of points (q, 3) on the target, in world space, and (q,) whether they exist."""
    target = pair.target
    triangle, barycentric = closest_points(points, target.vertices, target.triangles)
    images = match.surface_map.at(pair.source, target, triangle, barycentric).interpolate(pair.source.vertices)
    return images, _in_mask(match.has_partner, target.triangles[triangle])


def partners_on_target(pair: ObjectPair, match: StoredMatch, points: Floats) -> tuple[Floats, Booleans]:
    """Preimages (q, 3) on the target of points (q, 3) on the source, of nearest image, and (q,) whether they exist."""
    source, target = pair.source, pair.target
    of_source, _ = closest_points(points, source.vertices, source.triangles)
    found = match.surface_map.preimages(source, target, points).interpolate(target.vertices)
    return found, _in_mask(match.source_has_partner, source.triangles[of_source])


def _in_mask(mask: Booleans | None, corners: Integers) -> Booleans:
    """(q,) whether all corners (q, 3) have a partner; true if that is not known."""
    return np.ones(len(corners), dtype=bool) if mask is None else mask[corners].all(axis=1)
