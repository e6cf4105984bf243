# SPDX-License-Identifier: GPL-3.0-or-later
"""Map eyelashes by the lids that they grow on.

Lashes and tear lines are thin shells, which slide along each other in a map. The map of the skin beside them is more
exact: relative to the skin, lashes of two persons are at the same places.

In the corners of an eye, lashes of both lids are close to each other. If they are pieces that are not connected, all
vertices of a piece therefore have their images on the same piece.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import components, unique_edges
from zoomout_core.transfer.mapped_target import MappedTarget

# Vertices of the skin whose mean determines the place of a lash. One is too exact: its image is a little off.
NEIGHBOURS = 8
# A piece of a target's lashes is on one piece of the source if it is nearer, on average, than this share of its extent.
# Lashes of both lids in one piece are farther away, by half the opening of the eye.
MAX_DISTANCE = 0.05


def attach_lashes(closing: Booleans, skin: int, mapped: MappedTarget) -> MappedTarget:
    """The target with images of lashes at the same places beside the source's skin.

    Takes a mask (n,) of the vertices of the source's working mesh that blinks move, and the number of the skin among
    its components. Lashes are the other components that blinks move. A target without a skin is returned as it is.
    """
    source, working = mapped.source, mapped.source.working
    lashes = np.unique(working.component[closing & (working.component != skin)])
    at = working.vertex_of[source.triangles[:, 0]]
    component = np.where(at >= 0, working.component[at], -1)
    image = component[mapped.surface_map.triangle]
    on_skin, on_lash = np.flatnonzero(image == skin), np.isin(image, lashes)
    if len(on_skin) < NEIGHBOURS or not on_lash.any():
        return mapped
    places, images = mapped.target.vertices, mapped.points
    turn = procrustes(places[on_skin], images[on_skin]).linear
    skin_tree = cKDTree(places[on_skin])
    triangles, weights = mapped.surface_map.triangle.copy(), mapped.surface_map.barycentric.copy()
    piece = components(unique_edges(mapped.target.triangles)[0], len(places))
    for lash in lashes:
        own, there = np.flatnonzero(image == lash), np.flatnonzero(component == lash)
        beside = on_skin[skin_tree.query(places[own], NEIGHBOURS)[1]]
        goals = (images[beside] + (places[own, None] - places[beside]) @ turn.T).mean(axis=1)
        triangles[own], weights[own] = _closest_on_pieces(goals, piece[own], source, there)
    return replace(mapped, surface_map=SurfaceMap(triangles, weights, mapped.surface_map.source_triangles))


def _closest_on_pieces(goals: Floats, piece: Integers, source: Surface, lash: Integers) -> tuple[Integers, Floats]:
    """The closest points to goals (q, 3) on triangles (l,) of a lash, on the same piece for each piece of goals (q,).

    Returns their triangles (q,) and barycentric coordinates (q, 3).
    """
    corners = source.triangles[lash]
    rows, piece = np.unique(corners), np.unique(piece, return_inverse=True)[1]
    piece_there = components(unique_edges(corners)[0], len(source.vertices))
    numbers = np.unique(piece_there[rows])
    trees = [cKDTree(source.vertices[rows[piece_there[rows] == number]]) for number in numbers]
    count = np.bincount(piece)
    distances = np.array([np.bincount(piece, tree.query(goals)[0]) / count for tree in trees])
    extent = np.array([np.linalg.norm(np.ptp(goals[piece == own], axis=0)) for own in range(len(count))])
    nearest = np.where(distances.min(axis=0) < MAX_DISTANCE * extent, numbers[distances.argmin(axis=0)], -1)[piece]
    triangles, weights = np.empty(len(goals), dtype=np.int64), np.empty((len(goals), 3))
    for number in np.unique(nearest):
        own, there = np.flatnonzero(nearest == number), lash
        if number >= 0:
            there = lash[piece_there[corners[:, 0]] == number]
        found, weights[own] = closest_points(goals[own], source.vertices, source.triangles[there])
        triangles[own] = there[found]
    return triangles, weights
