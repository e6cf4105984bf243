"""Functions of the intrinsic geometry alone, comparable from shape to shape.

Wave kernel signature: Aubry, Schlickewei and Cremers 2011. Heat kernel signature: Sun, Ovsjanikov and
Guibas 2009. Pseudo-scalars <n, grad f x grad g> turn their sign under a reflection, which no signature does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.tuning import Tuning, tuned

# Norm of functions that vanish but for rounding; signatures are of order one.
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
    """(n, count) wave kernel signatures at `count` energies.

    Args:
        basis: eigenfunctions; the constant one is left out.
        count: number of energies.
        k: use the first k eigenfunctions (all when None).
        width: standard deviation of an energy band, in steps between energies.
    """
    log_eigenvalues = np.log(np.maximum(basis.eigenvalues[1:k], 1e-12))
    low, high = log_eigenvalues[0], log_eigenvalues[-1]
    sigma = width * (high - low) / count
    margin = min(2 * sigma, (high - low) / 4)
    energies = np.linspace(low + margin, high - margin, count)
    weights = np.exp(-((energies[:, None] - log_eigenvalues) ** 2) / (2 * sigma**2))
    weights /= weights.sum(axis=1, keepdims=True)
    return basis.eigenvectors[:, 1:k] ** 2 @ weights.T


def heat_kernel_signature(basis: SpectralBasis, count: int = 100, k: int | None = None) -> Floats:
    """(n, count) heat kernel signatures at times spread geometrically over what the basis resolves."""
    eigenvalues = basis.eigenvalues[1:k]
    times = np.geomspace(4 * np.log(10) / eigenvalues[-1], 4 * np.log(10) / eigenvalues[0], count)
    return basis.eigenvectors[:, 1:k] ** 2 @ np.exp(-np.outer(eigenvalues, times))


def signature_bands(basis: SpectralBasis, count: int, k: int) -> Floats:
    """(n, count) wave kernel signatures in narrow bands of energy, of mean zero and unit norm; k as above."""
    bands = wave_kernel_signature(basis, count, k, BANDS.width)
    bands = bands - basis.areas @ bands
    return unit_columns(bands, np.sqrt(basis.areas @ bands**2))


def unit_columns(functions: Floats, norms: Floats) -> Floats:
    """Functions (n, d) divided by their norms (d,); those of rounding alone, as on a sphere, stay zero."""
    return np.divide(functions, norms, out=np.zeros_like(functions), where=norms > NOTHING)


def pseudo_scalar_signatures(mesh: WorkingMesh, areas: Floats, bands: Floats) -> Floats:
    """(n, d) pseudo-scalars of every two of the signature bands (n, b) that are not neighbours."""
    i, j = np.triu_indices(bands.shape[1], k=2)
    return pseudo_scalars(mesh, areas, bands[:, i], bands[:, j])


def pseudo_scalars(mesh: WorkingMesh, areas: Floats, f: Floats, g: Floats) -> Floats:
    """(n, d) the pseudo-scalar <n, grad f x grad g> of function pairs, averaged onto the vertices.

    Args:
        mesh: supplies the outward orientation.
        areas: (n,) lumped vertex areas.
        f: (n, d) first function of each pair.
        g: (n, d) second function of each pair.
    """
    a, b, c = mesh.oriented_triangles.T
    wedge = ((f[b] - f[a]) * (g[c] - g[a]) - (f[c] - f[a]) * (g[b] - g[a])) / 6
    return sum_at_vertices(mesh.triangles, wedge, len(areas)) / areas[:, None]


def mean_curvature(mesh: WorkingMesh, stiffness: csc_array, areas: Floats) -> Floats:
    """(n,) mean curvature, positive where the surface bulges outwards, per square root of its area."""
    along_normal = np.einsum("ij,ij->i", stiffness @ mesh.vertices, mesh.vertex_normals)
    return np.asarray(along_normal / (2 * areas))


def sum_at_vertices(triangles: Integers, values: Floats, n: int) -> Floats:
    """(n, d) sum of the triangles' values (m, d) at each vertex."""
    m = len(triangles)
    at_vertex = csr_array((np.ones(3 * m), (triangles.ravel(), np.repeat(np.arange(m), 3))), shape=(n, m))
    return np.asarray(at_vertex @ values)
