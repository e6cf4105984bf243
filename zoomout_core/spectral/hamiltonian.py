# SPDX-License-Identifier: GPL-3.0-or-later
"""Eigenfunctions of Hamiltonians, which are concentrated where a potential is low.

Melzi et al., Localized manifold harmonics for spectral shape analysis (2018); Choukroun et al., Hamiltonian operator
for spectral shape analysis (2020): (W + tau A diag(v)) phi = lambda A phi, with a potential v.
"""

from __future__ import annotations

from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats, segment_sum
from zoomout_core.mesh.shapes import ShapeLike, as_shape, as_surface
from zoomout_core.runtime.threads import one_blas_thread
from zoomout_core.spectral.eigenbasis import SpectralBasis, basis_of, check_is_whole, on_shape
from zoomout_core.spectral.laplacian import mesh_laplacian


def hamiltonian_basis(
    shape: ShapeLike, potential: ArrayLike, k: int = 200, strength: float = 10.0, seed: int = 0
) -> SpectralBasis:
    """Compute the first `k` eigenfunctions of a Hamiltonian, which are concentrated where the potential is low.

    The potential is scaled by tau, a multiple of 4 pi k / A, where A is the area of the part with a low potential. By
    Weyl's law this is the k-th eigenvalue of a surface of that area. Functions decay in the rest over a length of about
    one over the square root of tau. With a potential of zero this is the `eigenbasis`.

    For a part and its whole, give the whole a potential outside of the part's region, and use `zoomout` with equal
    sizes. The region must be known. If it misses some of the part, or includes much else, maps are worse than those of
    plain bases with `slanted_sizes`, which need no region.

    Args:
        shape: what to analyse.
        potential: (n,) at the vertices or points, from 0 where functions are concentrated to 1 where they vanish.
        k: number of eigenfunctions; at most one less than the vertices, and than those with a potential below 1.
        strength: tau, relative to that eigenvalue.
        seed: start of the iteration.

    Returns:
        A basis with a row for every vertex of the surface, or every point, orthonormal over the whole surface at unit
        area.

    Raises:
        ValueError: the potential is not (n,) numbers from 0 to 1, leaves room for fewer than k functions, or strength
            is not a number of at least zero.
        MeshError: k is out of range, or no surface passes through the points.
        TypeError: the shape is of another type, see `ShapeLike`, or k is not an integer.

    Example:
        >>> potential = (source.vertices[:, 2] < 0).astype(float)  # functions avoid the lower half
        >>> zo.hamiltonian_basis(source, potential, k=10).eigenvalues.shape
        (10,)
    """
    shape = as_shape(shape)
    surface = as_surface(shape)
    check_is_whole(k)
    if not (isinstance(strength, Real) and 0 <= strength < np.inf):
        raise ValueError(f"strength is {strength!r}: give a finite number of at least zero.")
    working = surface.working
    used = working.vertex_of >= 0
    welded = working.vertex_of[used]
    given = _check_potential(potential, len(surface.vertices))[used]
    barrier = segment_sum(given, welded) / np.bincount(welded)  # means over the vertices welded into one
    laplacian = mesh_laplacian(working.vertices, working.triangles)
    room = int((barrier < 1).sum())
    if room < max(k, 1):
        raise ValueError(
            f"The potential is below 1 at {room} vertices, too few for {k} eigenfunctions: lower the potential, or "
            "request fewer."
        )
    tau = strength * 4 * np.pi * k / (laplacian[1] @ (1 - barrier))
    with one_blas_thread:
        basis = basis_of(working, laplacian, k, seed, tau * barrier)
    return on_shape(basis, shape)


def _check_potential(potential: ArrayLike, n: int) -> Floats:
    values = np.asarray(potential)
    if values.shape != (n,) or values.dtype.kind not in "biuf":
        raise ValueError(f"The potential must be {n} numbers, one for each vertex, not {values.dtype} {values.shape}.")
    wrong = values[~((values >= 0) & (values <= 1))]  # also finds NaN
    if len(wrong):
        raise ValueError(f"The potential must be from 0 to 1, and {wrong[0]} is not: scale it.")
    return values.astype(np.float64)
