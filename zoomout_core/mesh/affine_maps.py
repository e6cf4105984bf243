# SPDX-License-Identifier: GPL-3.0-or-later
"""Affine maps of vertices, and their means by skin weights (linear blend skinning)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats


def blend_matrices(matrices: Floats, weights: csr_array) -> Floats:
    """(n, 3, 4) means of affine maps (b, 3, 4) by weights (n, b) of any sum; zero without weights."""
    return np.asarray(normalise(weights) @ matrices.reshape(-1, 12)).reshape(-1, 3, 4)


def transform_points(matrices: Floats, points: Floats) -> Floats:
    """(n, 3) transform each of some points (n, 3) by its own affine map (n, 3, 4)."""
    return np.asarray(np.einsum("nxy,ny->nx", matrices[:, :, :3], points) + matrices[:, :, 3])


def mirror_factors(mirrored: bool) -> Floats:
    """(3,) factors of coordinates and normals: those that mirror a shape at the plane x = 0, or ones."""
    return np.array([-1.0, 1.0, 1.0]) if mirrored else np.ones(3)


def normalise(weights: csr_array) -> csr_array:
    """Weights (n, b) of bones as float64, scaled to sum to one at each vertex; vertices without weights keep none."""
    shares = csr_array(weights.astype(np.float64))  # a copy
    sums = np.asarray(shares.sum(axis=1)).ravel()
    shares.data /= np.repeat(np.where(sums > 0, sums, 1), np.diff(shares.indptr))
    return shares
