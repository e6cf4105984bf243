# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a map is from turning and scaling the surroundings of each vertex, without reflecting them.

The surroundings are a few rings of neighbours. The best similarity follows from the singular values of the covariance
of offsets and their images (Umeyama 1991, see `procrustes.py`). The residual depends neither on the pose nor on the
scale of either surface, and uses no eigenfunctions.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, eye_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import unique_edges

# Vertices whose surroundings are found at once; bounds the memory.
BLOCK = 20_000
# Squared offsets, relative to the squared size of the surface, that are rounding.
ROUNDING = 1e-18


def similarity_residual(vertices: Floats, triangles: Integers, images: Floats, rings: int) -> Floats:
    """How badly the best similarity without reflection maps the surroundings of each vertex to their images.

    It is one minus the share of the images' offsets that the similarity explains, by least squares. Offsets are
    weighted by the inverse of their squared length, so that all rings have the same influence.

    Args:
        vertices: (n, 3) of a mesh.
        triangles: (m, 3) of the mesh.
        images: (n, 3) of the vertices.
        rings: number of edges to the farthest neighbours of a vertex.

    Returns:
        (n,) in [0, 1]: 0 where the map is a similarity, near 1 where it scatters the surroundings or collapses them to
        a point.
    """
    edges, _ = unique_edges(triangles)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    n = len(vertices)
    near = csr_array((np.ones(len(rows), dtype=np.int32), (rows, columns)), shape=(n, n)) + eye_array(n, dtype=np.int32)
    x, y = (points - points.mean(axis=0) for points in (vertices, images))
    moments = np.hstack(
        [np.ones((n, 1)), x, y, (x[:, :, None] * y[:, None]).reshape(n, 9), (y**2).sum(axis=1)[:, None]]
    )
    residual = np.empty(n)
    for start in range(0, n, BLOCK):
        at = slice(start, start + BLOCK)
        around = near[at]
        for _ in range(rings - 1):
            around = around @ near
            around.data[:] = 1
        residual[at] = _residual(around.tocsr(), x, y, moments, np.arange(n)[at])
    return residual


def _residual(around: csr_array, x: Floats, y: Floats, moments: Floats, at: Integers) -> Floats:
    """(b,) residuals at some vertices, from their neighbours (b, n) and the moments (n, 17) of all."""
    center = np.repeat(at, np.diff(around.indptr))
    squares = ((x[around.indices] - x[center]) ** 2).sum(axis=1)
    apart = squares > ROUNDING * (x**2).sum(axis=1).max()
    weights = np.divide(1.0, squares, out=np.zeros(len(squares)), where=apart)
    count = np.bincount(np.repeat(np.arange(len(at)), np.diff(around.indptr)), apart, len(at))
    sums = csr_array((weights, around.indices, around.indptr), shape=around.shape) @ moments
    total, sum_x, sum_y, sum_xy, sum_yy = np.split(sums, [1, 4, 7, 16], axis=1)
    x, y = x[at], y[at]
    # Moments about the vertex itself and its image, from those about the origin.
    cross = sum_xy.reshape(-1, 3, 3) - x[:, :, None] * sum_y[:, None] - sum_x[:, :, None] * y[:, None]
    cross += total[:, :, None] * x[:, :, None] * y[:, None]
    spread = sum_yy[:, 0] - 2 * (y * sum_y).sum(axis=1) + total[:, 0] * (y**2).sum(axis=1)
    singular = np.linalg.svd(cross, compute_uv=False)
    singular[:, 2] *= np.sign(np.linalg.det(cross))
    explained = singular.sum(axis=1) ** 2
    spread *= count  # the sum of the weighted squares of x
    return np.clip(1 - np.divide(explained, spread, out=np.zeros(len(at)), where=spread > 0), 0, 1)
