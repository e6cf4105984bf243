# SPDX-License-Identifier: GPL-3.0-or-later
"""Extrapolation of a map to vertices without a partner on the source."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph


def extrapolate_map(surface_map: SurfaceMap, target: Surface, has_partner: Booleans) -> SurfaceMap:
    """Extrapolate a map: a vertex without a partner (n_t,) takes the image of the nearest vertex with one.

    Distances are along the surface, so labels and UVs continue from their surroundings. Parts of the target without any
    partner keep their images.
    """
    working = target.working
    giver = np.full(len(working.vertices), -1)
    known = np.flatnonzero(has_partner & (working.vertex_of >= 0))
    giver[working.vertex_of[known]] = known
    places = np.flatnonzero(giver >= 0)
    alone = np.flatnonzero(~has_partner & (working.vertex_of >= 0))
    if not len(places) or not len(alone):
        return surface_map
    graph = edge_graph(working.vertices, working.triangles)
    _, _, nearest = dijkstra(graph, indices=places, min_only=True, return_predecessors=True)
    nearest = nearest[working.vertex_of[alone]]
    alone, nearest = alone[nearest >= 0], giver[nearest[nearest >= 0]]
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    triangle[alone], barycentric[alone] = triangle[nearest], barycentric[nearest]
    return SurfaceMap(triangle, barycentric, surface_map.source_triangles)
