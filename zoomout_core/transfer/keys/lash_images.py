# SPDX-License-Identifier: GPL-3.0-or-later
"""Map eyelashes by the lids that they grow on.

Lashes and tear lines are thin shells, which slide along each other in a map. The map of the skin beside them is more
exact: relative to the skin, lashes of two persons are at the same places.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.transfer.mapped_target import MappedTarget

# Vertices of the skin whose mean determines the place of a lash. One is too exact: its image is a little off.
NEIGHBOURS = 8


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
    for lash in lashes:
        own, there = np.flatnonzero(image == lash), np.flatnonzero(component == lash)
        beside = on_skin[skin_tree.query(places[own], NEIGHBOURS)[1]]
        goals = (images[beside] + (places[own, None] - places[beside]) @ turn.T).mean(axis=1)
        found, weights[own] = closest_points(goals, source.vertices, source.triangles[there])
        triangles[own] = there[found]
    return replace(mapped, surface_map=SurfaceMap(triangles, weights, mapped.surface_map.source_triangles))
