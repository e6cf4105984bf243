# SPDX-License-Identifier: GPL-3.0-or-later
"""Iterative closest points in the spectral embedding, with a functional map of fixed size.

Ovsjanikov et al., Functional maps: a flexible representation of maps between shapes (2012), section 6.3: a map that
preserves areas has an orthonormal functional map, so C is a rigid motion between the embeddings.
"""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.maps.zoomout import Refined
from zoomout_core.spectral.eigenbasis import SpectralBasis


def spectral_icp(
    basis_source: SpectralBasis, basis_target: SpectralBasis, initial: Integers, k: int = 50, iterations: int = 10
) -> Refined:
    """Refine a vertex map by alternating nearest neighbours with orthonormal functional maps.

    Args:
        basis_source: at least k eigenfunctions of the source, on which the images are.
        basis_target: as many of the target.
        initial: (n_t,) source vertex of each target vertex.
        k: size of the functional map.
        iterations: at least one.
    """
    vertex = initial
    for _ in range(iterations):
        functional_map = nearest_orthonormal(functional_map_of(vertex, basis_source, basis_target, k, k))
        vertex = vertex_map_of(functional_map, basis_source, basis_target)
    return Refined(functional_map, vertex)


def nearest_orthonormal(matrix: Floats) -> Floats:
    """The orthonormal matrix nearest to a square one (k, k): its polar factor."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)
