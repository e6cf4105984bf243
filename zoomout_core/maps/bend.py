# SPDX-License-Identifier: GPL-3.0-or-later
"""Bend a map near some places of the target, so that these land on their known images."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.straight_paths import follow_paths
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.triangles import edge_graph

# In widths of the Gaussian: beyond, where it is 1e-4, the map does not change.
REACH = 3.0
# Places closer together than the width would need alternating displacements much larger than their errors. So only the
# part that is smooth at that width is applied, down to the share SMOOTH of the largest singular value. Gaussians of
# half the width, and so on, at most WIDTHS, add the rest, until at most the share MET of the largest displacement is
# missing.
SMOOTH, WIDTHS, MET = 0.1, 7, 1e-3
# A straight path along the tangent misses its goal on a curved surface, each further one by a smaller part of the rest.
# The walk ends once the largest rest is this share of the largest displacement.
STRIDES, ARRIVED = 20, 1e-9
# Number of distances in memory at a time.
BLOCK = 1 << 23


def bend(
    surface_map: SurfaceMap,
    source_vertices: Floats,
    target_vertices: Floats,
    target_triangles: Integers,
    places: Integers,
    missed: Floats,
    width: float,
) -> SurfaceMap:
    """Displace the images of some places (l,) of the target by (l, 3).

    Elsewhere the displacement fades by exp(-(d / width)^2) with the geodesic distance d, and faster between places
    close together. Images move along the source, so that none jumps from lip to lip. Positions are (n_s, 3) and
    (n_t, 3), with coincident borders welded; the width is in the target's unit.
    """
    graph = edge_graph(target_vertices, target_triangles)
    size = max(1, BLOCK // len(target_vertices))
    starts = range(0, len(places), size)

    def distances(start: int) -> Floats:
        return np.atleast_2d(dijkstra(graph, indices=places[start : start + size], limit=REACH * width))

    if len(starts) == 1:
        distances = cache(distances)
    widths = width / 2.0 ** np.arange(WIDTHS)
    weights = _weights(np.concatenate([distances(start)[:, places] for start in starts]), missed, widths)
    moved = np.zeros(target_vertices.shape)
    for start in starts:
        distance = distances(start)
        for each, weight in zip(widths, weights, strict=False):
            moved += np.exp(-((distance / each) ** 2)).T @ weight[start : start + size]
    near = np.flatnonzero(moved.any(axis=1))
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    corners = surface_map.source_triangles
    images = triangle[near], barycentric[near]
    triangle[near], barycentric[near] = follow_paths(source_vertices, corners, *images, moved[near])
    goals = surface_map.interpolate(source_vertices)[places] + missed
    for _ in range(STRIDES):
        images = triangle[places], barycentric[places]
        left = goals - SurfaceMap(*images, corners).interpolate(source_vertices)
        if np.abs(left).max(initial=0) <= ARRIVED * np.abs(missed).max(initial=0):
            break
        triangle[places], barycentric[places] = follow_paths(source_vertices, corners, *images, left)
    return SurfaceMap(triangle, barycentric, corners)


def _weights(distance: Floats, missed: Floats, widths: Floats) -> list[Floats]:
    """For each width the coefficients (l, 3) of the Gaussians around places (l,)."""
    weights, enough = [], MET * np.abs(missed).max(initial=0)
    for width in widths:
        kernel = np.exp(-((distance / width) ** 2))
        weights.append(np.linalg.lstsq(kernel, missed, rcond=SMOOTH)[0])
        missed = missed - kernel @ weights[-1]
        if np.abs(missed).max(initial=0) <= enough:
            break
    return weights
