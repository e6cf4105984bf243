# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of descriptors in a basis: matrices that a functional map commutes with.

Multiplication by a descriptor: Nogneng and Ovsjanikov, Informative Descriptor Preservation via Commutativity (2017).
Derivatives along a descriptor's level lines, which change sign under a reflection: Ren, Poulenard, Wonka and
Ovsjanikov, Continuous and Orientation-preserving Correspondences via Functional Maps (2018).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats
from zoomout_core.mesh.shapes import ShapeLike, as_surface
from zoomout_core.spectral.eigenbasis import SpectralBasis, check_size


def multiplication_operators(basis: SpectralBasis, descriptors: ArrayLike, k: int) -> Floats:
    """(d, k, k) multiplication by each descriptor f, Phi' A diag(f) Phi; symmetric.

    Args:
        basis: eigenfunctions.
        descriptors: (n, d) values at the basis's vertices, or (n,) for one descriptor.
        k: use the first k eigenfunctions.

    Raises:
        ValueError: descriptors do not fit the basis or are not finite, or k exceeds the size of the basis.

    Example:
        >>> zo.multiplication_operators(bases[0], source.vertices, 10).shape
        (3, 10, 10)
    """
    functions = check_descriptors(basis, descriptors, "The descriptors")
    check_size(basis, k)
    rows = basis.eigenvectors[:, :k]
    weighted = (basis.areas[:, None] * rows).T
    return np.stack([(weighted * f) @ rows for f in functions.T])


def orientation_operators(shape: ShapeLike, basis: SpectralBasis, descriptors: ArrayLike, k: int) -> Floats:
    """(d, k, k) operators g -> <n x grad f, grad g> of each descriptor f, with the outward normals n.

    They are integrated exactly for linear functions, and do not depend on the metric. They are antisymmetric on a
    closed surface. A map that keeps the orientation commutes with them; one that reverses it changes their sign.

    Args:
        shape: the surface of the basis.
        basis: eigenfunctions.
        descriptors: (n, d) values at the vertices, or (n,) for one descriptor.
        k: use the first k eigenfunctions.

    Raises:
        ValueError: as for `multiplication_operators`, or the basis is of another surface.
        MeshError: no surface passes through the points.

    Example:
        >>> zo.orientation_operators(source, bases[0], source.vertices, 10).shape
        (3, 10, 10)
    """
    surface = as_surface(shape)
    if len(surface.vertices) != len(basis.areas):
        raise ValueError(
            f"The basis has {len(basis.areas)} vertices, but the surface has {len(surface.vertices)}: give the basis "
            "of this surface."
        )
    functions = check_descriptors(basis, descriptors, "The descriptors")
    check_size(basis, k)
    triangles = surface.triangles[surface.working.triangle_of]
    side = np.where(surface.working.flipped, -1.0, 1.0)
    corners = basis.eigenvectors[:, :k][triangles.T]  # (3, m, k)
    mean = (corners.sum(axis=0) * (side / 6)[:, None]).T
    opposite = np.roll(corners, -1, axis=0) - np.roll(corners, 1, axis=0)  # edges opposite to corners
    operators = np.empty((functions.shape[1], k, k))
    for operator, f in zip(operators, functions[triangles.T].transpose(2, 0, 1), strict=True):
        operator[:] = mean @ sum(f[i, :, None] * opposite[i] for i in range(3))
    return operators


def check_descriptors(basis: SpectralBasis, descriptors: ArrayLike, what: str) -> Floats:
    """Check a user's descriptors (n, d), or a single one (n,), against their basis.

    Raises:
        ValueError: they are missing, not finite, or do not fit the basis's vertices; `what` begins the message.
    """
    try:
        functions = np.asarray(descriptors, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be an array of numbers, a row for each vertex.") from None
    if functions.ndim == 1:
        functions = functions[:, None]
    if functions.ndim != 2 or len(functions) != len(basis.areas):
        raise ValueError(
            f"{what} must have a row for each of the basis's {len(basis.areas)} vertices, not the shape "
            f"{functions.shape}."
        )
    if functions.shape[1] == 0:
        raise ValueError(f"{what} are empty: give at least one.")
    if not np.isfinite(functions).all():
        raise ValueError(f"{what} must be finite numbers: correct them, or leave out those that are not.")
    return functions
