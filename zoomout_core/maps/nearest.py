# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact nearest neighbours between rows of embeddings."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import AnyFloats, Integers, SingleFloats
from zoomout_core.geometry.embedded_surface import SINGLE_PRECISION_DIMENSION

# Entries of a block of inner products that is computed at once; bounds the memory.
BLOCK = 1 << 24
# Bound on the error of squared distances by single-precision products, relative to the squared norms.
ROUNDING = 1e-6

# A k-d tree is faster than inner products up to this dimension, for more points than that. All searches are exact.
MAX_TREE_DIMENSION = 8
MIN_TREE_POINTS = 1000
# Minimum query-point pairs for excluding points by clusters, and clusters per square root of the number of points.
MIN_CLUSTERED_PAIRS = 1 << 27
CLUSTERS_PER_ROOT = 5


def nearest(queries: AnyFloats, points: AnyFloats) -> Integers:
    """(..., q) the row of `points` (..., n, k) nearest to each row of `queries` (q, k); stacks need few points."""
    k = queries.shape[1]
    if points.ndim == 2 and k <= MAX_TREE_DIMENSION and len(points) > MIN_TREE_POINTS:
        return np.asarray(cKDTree(points).query(queries)[1])
    clustered = points.ndim == 2 and len(queries) * len(points) > MIN_CLUSTERED_PAIRS
    if clustered and k >= SINGLE_PRECISION_DIMENSION:
        return _nearest_by_clusters(queries.astype(np.float32), points.astype(np.float32))
    dtype: type = np.float32 if k >= SINGLE_PRECISION_DIMENSION else np.float64
    table = _table(points.astype(dtype))
    extended = _extend(queries.astype(dtype))
    found = np.empty((*points.shape[:-2], len(queries)), dtype=np.int64)
    rows = max(1, BLOCK * k // points.size)
    for start in range(0, len(queries), rows):
        found[..., start : start + rows] = np.argmax(extended[start : start + rows] @ table, axis=-1)
    return found


def nearest_among(queries: AnyFloats, points: AnyFloats, candidates: Integers) -> Integers:
    """(q,) the nearest of some candidate rows (q, c) of `points` for each row of `queries` (q, k)."""
    points = points.astype(np.float32)
    half_norm = np.einsum("nk,nk->n", points, points) / 2
    found = np.empty(len(queries), dtype=np.int64)
    rows = max(1, BLOCK // (4 * candidates.shape[1] * points.shape[1]))
    for start in range(0, len(queries), rows):
        near = candidates[start : start + rows]
        block = queries[start : start + rows].astype(np.float32)
        score = (points[near] @ block[:, :, None])[:, :, 0] - half_norm[near]
        found[start : start + rows] = near[np.arange(len(near)), np.argmax(score, axis=1)]
    return found


def _table(points: AnyFloats) -> AnyFloats:
    """(..., k + 1, n) table of points: |x - y|^2 is smallest where x.y - |y|^2 / 2 is largest; has both terms."""
    half_norm = np.einsum("...nk,...nk->...n", points, points) / 2
    return np.concatenate([np.swapaxes(points, -1, -2), -half_norm[..., None, :]], axis=-2)


def _extend(queries: AnyFloats) -> AnyFloats:
    """(q, k + 1) queries, extended for the product with a table."""
    return np.column_stack([queries, np.ones(len(queries), dtype=queries.dtype)])


def _nearest_by_clusters(queries: SingleFloats, points: SingleFloats) -> Integers:
    """The same, without products with points of clusters that are too far away to contain the nearest one.

    Queries with the same nearest centre are processed together. The nearest point in its cluster bounds the distance,
    and the triangle inequality rules out other clusters.
    """
    count = int(CLUSTERS_PER_ROOT * np.sqrt(len(points)))
    centres = points[np.random.default_rng(0).choice(len(points), count, replace=False)]
    owner, distance = _nearest_centre(points, centres)
    radius = np.zeros(count, dtype=np.float32)
    np.maximum.at(radius, owner, distance)
    by_cluster = np.argsort(owner, kind="stable")
    begin = np.searchsorted(owner[by_cluster], np.arange(count + 1))
    rows = np.ascontiguousarray(_table(points[by_cluster]).T)  # copying whole rows is faster
    largest = np.einsum("nk,nk->n", points, points).max() + np.einsum("qk,qk->q", queries, queries).max()
    slack = float(np.sqrt(ROUNDING * largest))

    own, _ = _nearest_centre(queries, centres)
    order = np.argsort(own, kind="stable")
    table_of_centres = _table(centres)
    found = np.empty(len(queries), dtype=np.int64)
    groups = np.split(order, np.flatnonzero(np.diff(own[order])) + 1)
    most = max(1, BLOCK // len(points))  # queries at a time, should no cluster be ruled out
    for group in (alike[start : start + most] for alike in groups for start in range(0, len(alike), most)):
        block = _extend(queries[group])
        half_norm = np.einsum("qk,qk->q", queries[group], queries[group]) / 2
        home = slice(begin[own[group[0]]], begin[own[group[0]] + 1])
        bound = _distance((block @ rows[home].T).max(axis=1, initial=-np.inf), half_norm)
        to_centres = _distance(block @ table_of_centres, half_norm[:, None])
        near = np.flatnonzero((to_centres - radius < bound[:, None] + slack).any(axis=0))
        members = np.concatenate([np.arange(begin[cluster], begin[cluster + 1]) for cluster in near])
        found[group] = by_cluster[members[np.argmax(block @ rows[members].T, axis=1)]]
    return found


def _nearest_centre(points: SingleFloats, centres: SingleFloats) -> tuple[Integers, SingleFloats]:
    """(n,) the centre nearest to each point, and (n,) its distance."""
    table = _table(centres)
    half_norm = np.einsum("nk,nk->n", points, points) / 2
    found, distance = np.empty(len(points), dtype=np.int64), np.empty(len(points), dtype=np.float32)
    rows = max(1, BLOCK // len(centres))
    for start in range(0, len(points), rows):
        score = _extend(points[start : start + rows]) @ table
        found[start : start + rows] = np.argmax(score, axis=1)
        distance[start : start + rows] = _distance(score.max(axis=1), half_norm[start : start + rows])
    return found, distance


def _distance(score: AnyFloats, half_norm: SingleFloats) -> AnyFloats:
    """Distances from products with a table."""
    return np.asarray(np.sqrt(np.maximum(2 * (half_norm - score), 0)))
