"""A map that is bent near some places of the target, so that these land where they are known to."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.triangles import edge_graph

# In widths of the Gaussian: beyond, where it is 1e-4, the map stays as it is.
REACH = 3.0


def bent(
    surface_map: SurfaceMap,
    source_vertices: Floats,
    target_vertices: Floats,
    target_triangles: Integers,
    places: Integers,
    missed: Floats,
    width: float,
) -> SurfaceMap:
    """The map whose images at some vertices are moved; elsewhere this fades with a Gaussian of the geodesic distance.

    Args:
        surface_map: from the target's vertices to the source.
        source_vertices: (n_s, 3) positions.
        target_vertices: (n_t, 3) positions.
        target_triangles: (m, 3) of these.
        places: (l,) vertices of the target.
        missed: (l, 3) by how much the image of each is to be moved.
        width: w of the Gaussian exp(-(d / w)^2), in the target's unit.
    """
    graph = edge_graph(target_vertices, target_triangles)
    distance = np.atleast_2d(dijkstra(graph, indices=places, limit=REACH * width))
    kernel = np.exp(-((distance / width) ** 2))
    near = np.flatnonzero(np.isfinite(distance).any(axis=0))
    images = surface_map.interpolate(source_vertices)[near]
    bent_images = images + kernel[:, near].T @ np.linalg.lstsq(kernel[:, places], missed, rcond=None)[0]
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    triangle[near], barycentric[near] = closest_points(bent_images, source_vertices, surface_map.source_triangles)
    return SurfaceMap(triangle, barycentric, surface_map.source_triangles)
