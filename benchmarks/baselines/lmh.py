# SPDX-License-Identifier: GPL-3.0-or-later
"""Localized manifold harmonics (LMH).

Melzi, Rodola, Castellani and Bronstein, Localized manifold harmonics for spectral shape analysis (2018). Functions on a
region come from the Laplacian with a potential outside, constrained to be orthogonal to the first k' eigenfunctions Psi
of the whole surface, so that they complement these locally:

    (W + tau A diag(v) + mu A Psi Psi' A) phi = lambda A phi,    tau and mu large.

ZoomOut's comparison of an object in clutter uses LMH's first step. We read it as follows: sparse matches locate the
region on both shapes; a functional map of fixed size between the two localised bases maps heat kernels at the
matches to each other in the least-squares sense; nearest neighbours in these bases give the map. The size is fixed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigsh

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.maps.functional_map import vertex_map_of
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.laplacian import mesh_laplacian

# tau and mu, relative to the k-th eigenvalue of a surface as large as the region, 4 pi k over its area.
LOCALITY, ORTHOGONALITY = 10.0, 100.0
# Number of eigenfunctions of the whole surface that the localised ones are orthogonal to.
GLOBAL = 20
# Ridge parameter of the least squares, relative to the mean square of a kernel's coefficients.
RIDGE = 1e-2


def localized_harmonics(
    surface: Surface, whole: SpectralBasis, potential: Floats, k: int, seed: int = 0
) -> SpectralBasis:
    """The first k localised harmonics of a region.

    Args:
        surface: connected, without unused vertices.
        whole: its eigenfunctions to which the harmonics are orthogonal.
        potential: (n,) from 0 on the region to 1 outside.
        k: how many.
        seed: of the initial vector.

    Returns:
        The harmonics; `components` is 0 because none of them is constant.
    """
    stiffness, areas = mesh_laplacian(surface.vertices, surface.triangles)
    scale = 4 * np.pi * k / (areas @ (1 - potential))
    operator = csc_array(stiffness + diags_array(LOCALITY * scale * areas * potential))
    # In y = A^1/2 phi: (S + mu U U') y = lambda y with U = A^1/2 Psi. Its inverse is a low-rank update of that of S
    # (Woodbury). A shift makes S definite if there is no potential.
    root = np.sqrt(areas)
    shift = 1e-2 * scale
    factor = factorise(operator + shift * diags_array(areas))
    U = root[:, None] * whole.eigenvectors

    def solve(right: Floats) -> Floats:
        return np.asarray(root * factor.solve(root * right))

    inverse_U = root[:, None] * factor.solve(root[:, None] * U)
    small = cho_factor(np.eye(U.shape[1]) / (ORTHOGONALITY * scale) + U.T @ inverse_U)

    def inverse(right: Floats) -> Floats:
        first = solve(right.ravel())
        return np.asarray(first - inverse_U @ cho_solve(small, U.T @ first))

    n = len(areas)
    start = np.random.default_rng(seed).standard_normal(n)
    largest, vectors = eigsh(LinearOperator((n, n), matvec=inverse, dtype=float), k, which="LA", v0=start, tol=1e-8)
    order = np.argsort(-largest)
    return SpectralBasis(1 / largest[order] - shift, vectors[:, order] / root[:, None], areas, surface.vertices, 0)


def lmh(basis_source: SpectralBasis, basis_target: SpectralBasis, matches: ArrayLike) -> Integers:
    """(n_t,) source vertex of each target vertex, from sparse matches in localised bases of equal size.

    Args:
        basis_source: localised harmonics of the surface that the map lands on.
        basis_target: the same of the surface that the map starts from.
        matches: (m, 2) target and source vertices.
    """
    on_target, on_source = np.asarray(matches).T
    C = transport(kernels(basis_source, on_source), kernels(basis_target, on_target))
    return vertex_map_of(C, basis_source, basis_target)


def kernels(basis: SpectralBasis, vertices: Integers) -> Floats:
    """(k, 3 m) coefficients of heat from each of m vertices, after three times, from the finest to a tenth of it."""
    times = np.geomspace(1, 10, 3) / basis.eigenvalues[-1]
    decayed = np.exp(-np.outer(times, basis.eigenvalues))  # (times, k)
    rows = basis.eigenvectors[vertices]
    return np.hstack([(each * rows).T for each in decayed])


def transport(of_source: Floats, of_target: Floats) -> Floats:
    """(k_t, k_s) the functional map that maps functions (k_s, d) to others (k_t, d), by ridge regression."""
    gram = of_source @ of_source.T
    gram += RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    return np.asarray(np.linalg.solve(gram, of_source @ of_target.T).T)
