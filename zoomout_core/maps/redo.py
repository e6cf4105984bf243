# SPDX-License-Identifier: GPL-3.0-or-later
"""Replace a map by another one in a part of the target, and keep it elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph

# Width of the transition between the maps inside the redone region, at unit area, and its largest fraction of the
# region's depth.
TRANSITION_WIDTH = 0.06
MAX_TRANSITION_FRACTION = 0.5


def redo_shares(mask: ArrayLike, target: Surface) -> Floats:
    """(n_t,) share of the new map, in [0, 1]: zero outside of a mask (n_t,) in [0, 1], growing inside."""
    weights = np.asarray(mask, dtype=np.float64)
    kept = np.flatnonzero(weights == 0)
    if not len(kept):
        return weights
    inside = dijkstra(edge_graph(target.vertices, target.triangles), indices=kept, min_only=True)
    depth = inside[np.isfinite(inside)].max(initial=0)
    width = min(TRANSITION_WIDTH * np.sqrt(target.area), MAX_TRANSITION_FRACTION * depth)
    if width == 0:
        return weights
    along = np.minimum(inside / width, 1)
    return np.asarray(weights * along**2 * (3 - 2 * along))


def redone(before: SurfaceMap, after: SurfaceMap, shares: Floats, source: Surface) -> SurfaceMap:
    """Blend two maps by the shares (n_t,) of the second, in [0, 1]; images are mixed in space, and exact at 0 and 1."""
    triangle = np.where(shares == 1, after.triangle, before.triangle)
    barycentric = np.where((shares == 1)[:, None], after.barycentric, before.barycentric)
    mixed = np.flatnonzero((shares > 0) & (shares < 1))
    if len(mixed):
        part: Floats = shares[mixed, None]
        old, new = (each.interpolate(source.vertices)[mixed] for each in (before, after))
        points = np.asarray((1 - part) * old + part * new, dtype=np.float64)
        triangle[mixed], barycentric[mixed] = closest_points(points, source.vertices, source.triangles)
    return SurfaceMap(triangle, barycentric, source.triangles)
