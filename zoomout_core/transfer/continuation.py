# SPDX-License-Identifier: GPL-3.0-or-later
"""The map where there is nothing on the source: continued from the nearest places that have a partner."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph


def continued(surface_map: SurfaceMap, target: Surface, has_partner: Booleans) -> SurfaceMap:
    """A map of which vertices without a partner lie where the nearest one along the surface lies that has one.

    So labels, UVs and whatever else is read there go on as they are beside it. Parts of the target that have no partner
    at all stay where they are.

    Args:
        surface_map: from the target.
        target: the surface that it starts from.
        has_partner: (n_t,) which of its vertices have a partner.
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
