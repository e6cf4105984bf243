# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples that cover a shape evenly."""

from __future__ import annotations

from functools import reduce
from operator import add

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers


def farthest_points(points: Floats, count: int) -> Integers:
    """(count,) numbers of farthest-point samples of points (n, d), beginning with the one farthest from the centroid.

    All points are chosen if there are fewer. Each is the point farthest, by Euclidean distance, from all earlier ones,
    so any leading part covers the shape too. The choice depends only on the shape, not on its placement, its unit or
    the order of its points.

    Example:
        >>> from zoomout_core.spectral.sampling import farthest_points
        >>> farthest_points(source.vertices, 10).shape
        (10,)
    """
    count = min(count, len(points))
    columns = np.ascontiguousarray(points.T)
    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = np.argmax(_squared_distance(columns, columns.mean(axis=1)))
    distance = _squared_distance(columns, columns[:, chosen[0]])
    for i in range(1, count):
        chosen[i] = np.argmax(distance)
        np.minimum(distance, _squared_distance(columns, columns[:, chosen[i]]), out=distance)
    return chosen


def _squared_distance(columns: Floats, point: Floats) -> Floats:
    """(n,) squared distances of points, as coordinates (d, n), from one point (d,)."""
    offset = columns - point[:, None]
    offset *= offset
    return np.asarray(reduce(add, offset))  # faster than a sum over the first axis


def voronoi_areas(points: Floats, areas: Floats, samples: Integers) -> Floats:
    """(s,) sums of the areas (n,) of the points nearest to each sample (s,), normalised to a total of one."""
    _, owner = cKDTree(points[samples]).query(points)
    weights = np.bincount(owner, areas, minlength=len(samples))
    return np.asarray(weights / weights.sum())
