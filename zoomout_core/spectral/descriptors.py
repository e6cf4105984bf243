# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that depend only on the intrinsic geometry, and so can be compared between shapes.

Wave kernel signature: Aubry, Schlickewei and Cremers 2011. Heat kernel signature: Sun, Ovsjanikov and Guibas 2009.
Pseudo-scalars <n, grad f x grad g> change sign under a reflection, unlike signatures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_array, csr_array

from zoomout_core.arrays import Floats, Integers, check_counts
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.spectral.eigenbasis import SpectralBasis, check_size
from zoomout_core.tuning import Tuning, tuned

# Norm of functions that are zero up to rounding, and minimum width of energy bands; both are otherwise of order one.
NOTHING = 1e-9


@dataclass(frozen=True)
class BandTuning(Tuning, set_by="correspondence"):
    """Signatures in narrow bands of energy.

    Attributes:
        width: standard deviation of a band.
    """

    width: float = tuned(2.0, "steps between energies", 0.1, 20)


BANDS = BandTuning()


def wave_kernel_signature(basis: SpectralBasis, count: int = 100, k: int | None = None, width: float = 7.0) -> Floats:
    """(n, count) wave kernel signatures: at each vertex, the probability of a particle of each energy.

    Args:
        basis: eigenfunctions; the null space, of functions that are constant on each component, is left out.
        count: number of energies, evenly spaced over the logarithms of the eigenvalues.
        k: use the first k eigenfunctions (all when None).
        width: standard deviation of an energy band, in steps between energies.

    Raises:
        ValueError: no eigenfunction is left, or a number is out of range.

    Example:
        >>> zo.wave_kernel_signature(bases[0], count=20).shape == (len(source.vertices), 20)
        True
    """
    used, weights = _wave_weights(basis, count, k, width)
    return basis.eigenvectors[:, used] ** 2 @ weights.T


def heat_kernel_signature(basis: SpectralBasis, count: int = 100, k: int | None = None) -> Floats:
    """(n, count) heat kernel signatures: at each vertex, the share of its heat that remains there.

    Args:
        basis: eigenfunctions; the null space, of functions that are constant on each component, is left out.
        count: number of times, spaced geometrically over the range that the basis resolves.
        k: use the first k eigenfunctions (all when None).

    Raises:
        ValueError: no eigenfunction is left, or a number is out of range.

    Example:
        >>> zo.heat_kernel_signature(bases[0], count=20).shape == (len(source.vertices), 20)
        True
    """
    used, weights = _heat_weights(basis, count, k)
    return basis.eigenvectors[:, used] ** 2 @ weights.T


def wave_kernel_map(
    basis: SpectralBasis, landmarks: ArrayLike, count: int = 100, k: int | None = None, width: float = 7.0
) -> Floats:
    """(n, l * count) wave kernels from each landmark to all vertices, one landmark after the other.

    At the landmark itself they are its wave kernel signature.

    Args:
        basis: eigenfunctions; the null space is left out.
        landmarks: (l,) vertex numbers.
        count: number of energies.
        k: use the first k eigenfunctions (all when None).
        width: standard deviation of an energy band, in steps between energies.

    Raises:
        ValueError: as for `wave_kernel_signature`, or landmarks are not vertices.

    Example:
        >>> zo.wave_kernel_map(bases[0], [0, 5], count=20).shape == (len(source.vertices), 40)
        True
    """
    return _from_landmarks(basis, landmarks, *_wave_weights(basis, count, k, width))


def heat_kernel_map(basis: SpectralBasis, landmarks: ArrayLike, count: int = 100, k: int | None = None) -> Floats:
    """(n, l * count) heat from each landmark at all vertices, one landmark after the other.

    At the landmark itself it is its heat kernel signature.

    Args:
        basis: eigenfunctions; the null space is left out.
        landmarks: (l,) vertex numbers.
        count: number of times.
        k: use the first k eigenfunctions (all when None).

    Raises:
        ValueError: as for `heat_kernel_signature`, or landmarks are not vertices.

    Example:
        >>> zo.heat_kernel_map(bases[0], [0, 5], count=20).shape == (len(source.vertices), 40)
        True
    """
    return _from_landmarks(basis, landmarks, *_heat_weights(basis, count, k))


def _from_landmarks(basis: SpectralBasis, landmarks: ArrayLike, used: slice, weights: Floats) -> Floats:
    vertices = vertex_numbers(landmarks, len(basis.areas), "Landmarks")
    at_landmarks = basis.eigenvectors[vertices, used]
    kernels = at_landmarks[:, None] * weights  # (l, count, k)
    return np.asarray(basis.eigenvectors[:, used] @ kernels.reshape(-1, weights.shape[1]).T)


def _wave_weights(basis: SpectralBasis, count: int, k: int | None, width: float) -> tuple[slice, Floats]:
    """The eigenfunctions beyond the null space, and (count, k) the weight of each at each energy."""
    if not 0 < width < np.inf:
        raise ValueError(f"The width of an energy band is {width!r}: give a number above zero.")
    used = _beyond_null_space(basis, count, k)
    log_eigenvalues = np.log(np.maximum(basis.eigenvalues[used], 1e-12))
    low, high = log_eigenvalues[0], log_eigenvalues[-1]
    sigma = max(width * (high - low) / count, NOTHING)
    margin = min(2 * sigma, (high - low) / 4)
    energies = np.linspace(low + margin, high - margin, count)
    weights = np.exp(-((energies[:, None] - log_eigenvalues) ** 2) / (2 * sigma**2))
    total = weights.sum(axis=1, keepdims=True)
    if not total.all():
        raise ValueError(f"Energy bands of width {width} lie between the eigenvalues: widen them.")
    return used, weights / total


def _heat_weights(basis: SpectralBasis, count: int, k: int | None) -> tuple[slice, Floats]:
    """The eigenfunctions beyond the null space, and (count, k) the remaining share of each at each time."""
    used = _beyond_null_space(basis, count, k)
    eigenvalues = basis.eigenvalues[used]
    times = np.geomspace(4 * np.log(10) / eigenvalues[-1], 4 * np.log(10) / eigenvalues[0], count)
    return used, np.exp(-np.outer(times, eigenvalues))


def _beyond_null_space(basis: SpectralBasis, count: int, k: int | None) -> slice:
    """The eigenfunctions used by descriptors; the null space is identified by rank, independent of rounding."""
    if not isinstance(basis, SpectralBasis):
        raise TypeError(f"Descriptors need a basis, not a {type(basis).__name__}: give zo.eigenbasis(surface).")
    k = len(basis.eigenvalues) if k is None else k
    check_counts(count=count)
    check_size(basis, k)
    if k <= basis.components:
        raise ValueError(
            f"Descriptors need more eigenfunctions than the {basis.components} that are constant on components: "
            "use more of them."
        )
    return slice(basis.components, k)


def signature_bands(basis: SpectralBasis, count: int, k: int) -> Floats:
    """(n, count) wave kernel signatures of the first k functions in narrow bands, with mean zero and unit norm."""
    bands = wave_kernel_signature(basis, count, min(k, len(basis.eigenvalues)), BANDS.width)
    bands = bands - basis.areas @ bands
    return unit_columns(bands, np.sqrt(basis.areas @ bands**2))


def unit_columns(functions: Floats, norms: Floats) -> Floats:
    """Divide functions (n, d) by their norms (d,); rounding errors, such as on a sphere, become zero."""
    return np.divide(functions, norms, out=np.zeros_like(functions), where=norms > NOTHING)


def pseudo_scalar_signatures(mesh: WorkingMesh, areas: Floats, bands: Floats) -> Floats:
    """(n, d) pseudo-scalars of all pairs of signature bands (n, b) that are not neighbours."""
    return pseudo_scalars(mesh, areas, bands, *np.triu_indices(bands.shape[1], k=2))


def pseudo_scalars(mesh: WorkingMesh, areas: Floats, functions: Floats, first: Integers, second: Integers) -> Floats:
    """(n, d) pseudo-scalars <n, grad f x grad g> of pairs of functions, averaged to vertices of areas (n,).

    The pairs (d,) are numbers of columns of the functions (n, c).
    """
    columns = np.ascontiguousarray(functions.T)
    a, b, c = (columns.take(corner, axis=1) for corner in mesh.oriented_triangles.T)
    along, across = b - a, c - a
    at_vertex = _at_vertex(mesh.triangles, len(areas))
    found = np.empty((len(areas), len(first)))
    for number, (f, g) in enumerate(zip(first, second, strict=True)):  # one after the other, they fit into the cache
        found[:, number] = at_vertex @ ((along[f] * across[g] - across[f] * along[g]) / 6)
    return found / areas[:, None]


def mean_curvature(mesh: WorkingMesh, stiffness: csc_array, areas: Floats) -> Floats:
    """(n,) mean curvature, positive where the surface bulges outwards, per square root of its area."""
    along_normal = np.einsum("ij,ij->i", stiffness @ mesh.vertices, mesh.vertex_normals)
    return np.asarray(along_normal / (2 * areas))


def sum_at_vertices(triangles: Integers, values: Floats, n: int) -> Floats:
    """(n, d) sum of the triangles' values (m, d) at each vertex."""
    return np.asarray(_at_vertex(triangles, n) @ values)


def _at_vertex(triangles: Integers, n: int) -> csr_array:
    """(n, m) matrix that sums values of triangles (m, 3) at vertices."""
    m = len(triangles)
    return csr_array((np.ones(3 * m), (triangles.ravel(), np.repeat(np.arange(m), 3))), shape=(n, m))
