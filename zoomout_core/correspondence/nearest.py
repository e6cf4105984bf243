"""Exact nearest neighbours between rows of embeddings."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.projection import SINGLE_PRECISION_DIMENSION
from zoomout_core.surface import Floats, Integers

# Entries of the block of inner products that is looked at together: bounds the memory.
BLOCK = 1 << 24
# Up to this dimension a tree beats products.
TREE_DIMENSION = 8


def nearest(queries: Floats, points: Floats) -> Integers:
    """(q,) the row of `points` (n, k) nearest to each row of `queries` (q, k)."""
    k = queries.shape[1]
    if k <= TREE_DIMENSION and len(points) > 1000:
        return np.asarray(cKDTree(points).query(queries)[1])
    dtype: type = np.float32 if k >= SINGLE_PRECISION_DIMENSION else np.float64
    # |x - y|^2 is least where x.y - |y|^2 / 2 is most; the second term rides along as one more column.
    half_norm = np.einsum("nk,nk->n", points, points) / 2
    table: Floats = np.column_stack([points, -half_norm]).astype(dtype).T
    extended: Floats = np.column_stack([queries, np.ones(len(queries))]).astype(dtype)
    found = np.empty(len(queries), dtype=np.int64)
    rows = max(1, BLOCK // len(points))
    for start in range(0, len(queries), rows):
        found[start : start + rows] = np.argmax(extended[start : start + rows] @ table, axis=1)
    return found


def nearest_among(queries: Floats, points: Floats, candidates: Integers) -> Integers:
    """(q,) for each row of `queries` (q, k) the nearest of a few rows of `points`, given by number (q, c)."""
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
