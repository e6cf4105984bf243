# SPDX-License-Identifier: GPL-3.0-or-later
"""The Laplace-Beltrami operator of meshes.

Sharp and Crane, A Laplacian for Nonmanifold Triangle Meshes (2020): an intrinsic Delaunay triangulation of the tufted
cover, which is robust to slivers, borders and non-manifold edges.
"""

from __future__ import annotations

import numpy as np
import robust_laplacian
from scipy.sparse import csc_array

from zoomout_core.arrays import Floats, Integers

# Vertex areas are clamped to this share of their mean: smaller ones only amplify rounding in the eigenvectors.
SMALLEST_AREA = 1e-6


def mesh_laplacian(vertices: Floats, triangles: Integers) -> tuple[csc_array, Floats]:
    """Stiffness matrix and lumped vertex areas of a triangle mesh in which every vertex is used.

    Returns:
        (n, n) symmetric positive semi-definite stiffness, and (n,) areas that sum to one.
    """
    stiffness, mass = robust_laplacian.mesh_laplacian(np.ascontiguousarray(vertices), np.ascontiguousarray(triangles))
    areas = mass.diagonal()
    areas = np.maximum(areas, SMALLEST_AREA * areas.mean())
    return csc_array(stiffness), areas / areas.sum()
