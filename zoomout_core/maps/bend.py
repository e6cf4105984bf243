# SPDX-License-Identifier: GPL-3.0-or-later
"""Bend a map near some places of the target, so that these land on their known images."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.straight_paths import follow_paths
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.triangles import edge_graph

# In widths of the Gaussian: beyond, where it is 1e-4, the map does not change.
REACH = 3.0
# Places closer together than the width would need alternating displacements much larger than their errors. So only the
# part that is smooth at that width is applied, from the singular values above this share of the largest. The remainder
# is added with Gaussians of half the width, and so on, with at most MAX_WIDTHS widths, until at most the share
# MAX_REMAINDER of the largest displacement is left.
MIN_SINGULAR_VALUE, MAX_WIDTHS, MAX_REMAINDER = 0.1, 7, 1e-3
# A straight path along the tangent misses its goal on a curved surface, each further one by a smaller part of the rest.
# Paths end once the largest error is this share of the largest displacement.
MAX_PATHS, MAX_ERROR = 20, 1e-9
# Number of distances in memory at a time.
BLOCK = 1 << 23


def bend(
    surface_map: SurfaceMap,
    source_vertices: Floats,
    target_vertices: Floats,
    target_triangles: Integers,
    places: Integers,
    displacements: Floats,
    width: float,
) -> SurfaceMap:
    """Displace the images of some vertices of the target on the source, and of those around them.

    The displacement fades by exp(-(d / width)^2) with the geodesic distance d, and faster between places close
    together. Images move along the source, so that none jumps from lip to lip.

    Args:
        surface_map: the map.
        source_vertices: (n_s, 3) positions, with coincident borders welded.
        target_vertices: (n_t, 3) positions, likewise.
        target_triangles: (m, 3) vertex numbers.
        places: (l,) vertices of the target.
        displacements: (l, 3) of their images.
        width: in the target's unit.
    """
    moves = _fade(displacements, places, target_vertices, target_triangles, width)
    near = np.flatnonzero(moves.any(axis=1))
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    corners = surface_map.source_triangles
    images = triangle[near], barycentric[near]
    triangle[near], barycentric[near] = follow_paths(source_vertices, corners, *images, moves[near])
    goals = surface_map.interpolate(source_vertices)[places] + displacements
    for _ in range(MAX_PATHS):
        images = triangle[places], barycentric[places]
        errors = goals - SurfaceMap(*images, corners).interpolate(source_vertices)
        if np.abs(errors).max(initial=0) <= MAX_ERROR * np.abs(displacements).max(initial=0):
            break
        triangle[places], barycentric[places] = follow_paths(source_vertices, corners, *images, errors)
    return SurfaceMap(triangle, barycentric, corners)


def _fade(displacements: Floats, places: Integers, vertices: Floats, triangles: Integers, width: float) -> Floats:
    """(n, 3) displacements of the images of all vertices (n, 3), which at some places (l,) are about those (l, 3)."""
    graph = edge_graph(vertices, triangles)
    size = max(1, BLOCK // len(vertices))
    starts = range(0, len(places), size)

    @lru_cache(maxsize=1)  # a single block is needed twice
    def distances(start: int) -> Floats:
        return np.atleast_2d(dijkstra(graph, indices=places[start : start + size], limit=REACH * width))

    widths = width / 2.0 ** np.arange(MAX_WIDTHS)
    between = np.concatenate([distances(start)[:, places] for start in starts])
    weights = _weights(between, displacements, widths)
    moves = np.zeros(vertices.shape)
    for start in starts:
        distance = distances(start)
        for each, weight in zip(widths, weights, strict=False):
            moves += np.exp(-((distance / each) ** 2)).T @ weight[start : start + size]
    return moves


def _weights(distance: Floats, displacements: Floats, widths: Floats) -> list[Floats]:
    """For each width, while it is needed, the coefficients (l, 3) of the Gaussians around places (l,)."""
    weights, enough = [], MAX_REMAINDER * np.abs(displacements).max(initial=0)
    for width in widths:
        kernel = np.exp(-((distance / width) ** 2))
        weights.append(np.linalg.lstsq(kernel, displacements, rcond=MIN_SINGULAR_VALUE)[0])
        displacements = displacements - kernel @ weights[-1]
        if np.abs(displacements).max(initial=0) <= enough:
            break
    return weights
