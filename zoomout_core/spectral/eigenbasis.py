# SPDX-License-Identifier: GPL-3.0-or-later
"""The first eigenfunctions of the Laplacian: W phi = lambda A phi with Phi' A Phi = I, at unit area.

`lanczos.py` computes them; if there is not enough memory, they are approximated on a decimated mesh.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_array, diags_array

from zoomout_core.arrays import Floats, check_counts, segment_sum
from zoomout_core.geometry.embedded_surface import Neighbourhoods, project_to_embedding
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.shapes import ShapeLike, as_shape, as_surface, from_working
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.summary import Summary
from zoomout_core.runtime.threads import one_blas_thread
from zoomout_core.spectral.lanczos import SURPLUS, eigenpairs
from zoomout_core.spectral.laplacian import mesh_laplacian

# Vertices of the decimated mesh that provides the basis if the factorised matrix of the mesh does not fit into memory.
COARSE_VERTICES = 50_000
# Damped Jacobi steps that smooth the interpolated functions across the edges of that mesh, and their damping.
JACOBI_STEPS = 10
JACOBI_DAMPING = 0.5

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, repr=False)
class SpectralBasis(Summary):
    """Eigenfunctions of the Laplacian, scaled to a surface of unit area.

    Attributes:
        eigenvalues: (k,) ascending.
        eigenvectors: (n, k) values at the vertices; orthonormal under `areas`.
        areas: (n,) lumped vertex areas, summing to one; zero for a vertex without a face.
        points: (n, 3) the vertices' positions.
        components: number of connected components on which constant functions are eigenfunctions, which is the number
            of zero eigenvalues. A Hamiltonian has none where its potential is above zero.

    Example:
        >>> basis = zo.eigenbasis(source, 10)
        >>> basis.eigenvectors.shape == (len(source.vertices), 10)
        True
    """

    eigenvalues: Floats
    eigenvectors: Floats
    areas: Floats
    points: Floats
    components: int = 1

    def _summary(self) -> dict[str, str]:
        return {
            "functions": f"{len(self.eigenvalues)} on {len(self.areas):,} vertices",
            "eigenvalues": f"{self.eigenvalues[0]:.4g} to {self.eigenvalues[-1]:.4g}",
        }

    def at_area(self, area: float) -> SpectralBasis:
        """The basis of the surface scaled to another area, such as a part's relative to that of its whole.

        Raises:
            ValueError: the area is not a positive number.
        """
        if not 0 < area < np.inf:
            raise ValueError(f"The area is {area!r}: give a positive number.")
        return SpectralBasis(
            self.eigenvalues / area, self.eigenvectors / np.sqrt(area), self.areas * area, self.points, self.components
        )

    def coefficients(self, functions: Floats) -> Floats:
        """(k, d) coefficients of functions (n, d) at the vertices.

        Example:
            >>> bases[0].coefficients(source.vertices).shape  # of the coordinates
            (60, 3)
        """
        return self.eigenvectors.T @ (self.areas[:, None] * functions)

    def smoothed(self, functions: Floats, time: float) -> Floats:
        """Functions (n, d) after diffusion over the given time (heat flow at unit area)."""
        return self.eigenvectors @ (np.exp(-time * self.eigenvalues)[:, None] * self.coefficients(functions))


def check_size(basis: SpectralBasis, k: int) -> None:
    """Check that a basis has the requested number of eigenfunctions.

    Raises:
        ValueError: k is not an integer from one to the size of the basis.
    """
    check_counts(k=k)
    if k > len(basis.eigenvalues):
        raise ValueError(
            f"k is {k}, but the basis has only {len(basis.eigenvalues)} eigenfunctions: compute more of them."
        )


def eigenbasis(shape: ShapeLike, k: int = 200, seed: int = 0) -> SpectralBasis:
    """Compute the first `k` eigenfunctions of a surface or point cloud.

    Coincident borders are welded first; each of several welded vertices gets its share of their area. A point cloud
    gets the basis of the surface that is reconstructed from it.

    Args:
        shape: what to analyse.
        k: number of eigenfunctions, including the constant one; at most one less than the vertices.
        seed: start of the iteration.

    Returns:
        A basis with a row for every vertex of the surface or every point.

    Raises:
        MeshError: k is out of range, or no surface passes through the points.
        TypeError: the shape is of another type, see `ShapeLike`, or k is not an integer.

    Example:
        >>> zo.eigenbasis(source, k=10).eigenvalues.shape
        (10,)
    """
    shape = as_shape(shape)
    surface = as_surface(shape)
    check_is_whole(k)
    with one_blas_thread:
        working = surface.working
        basis = basis_of(working, mesh_laplacian(working.vertices, working.triangles), k, seed)
    return on_shape(basis, shape)


def check_is_whole(k: object) -> None:
    """Check that a number of eigenfunctions is an integer.

    Raises:
        TypeError: it is not.
    """
    if not isinstance(k, int | np.integer):
        raise TypeError(f"The number of eigenfunctions is {k!r}: give a whole number.")


def on_shape(basis: SpectralBasis, shape: Surface | PointCloud) -> SpectralBasis:
    """Extend a basis of a shape's working mesh to every vertex of the surface or every point."""
    surface = as_surface(shape)
    working = surface.working
    vertex_of = working.vertex_of
    if np.array_equal(vertex_of, np.arange(len(working.vertices))):  # no vertex is welded or left out
        return replace(basis, points=surface.vertices)
    unused = vertex_of < 0
    copies = np.bincount(vertex_of[~unused], minlength=len(working.vertices))
    areas = np.where(unused, 0, (basis.areas / copies)[vertex_of])
    return replace(basis, eigenvectors=from_working(shape, basis.eigenvectors), areas=areas, points=surface.vertices)


def basis_of(
    mesh: WorkingMesh, laplacian: tuple[csc_array, Floats], k: int, seed: int, potential: Floats | None = None
) -> SpectralBasis:
    """Compute the first k eigenfunctions of W + diag(areas * potential), with W and areas of `mesh_laplacian`.

    If the factorised matrix does not fit into memory, they are approximated on a smaller mesh. The potential (n,) is at
    least zero, in units of eigenvalues.
    """
    stiffness, areas = laplacian
    constants = mesh.component if potential is None else np.setdiff1d(mesh.component, mesh.component[potential > 0])
    components = len(np.unique(constants))
    operator = _with_potential(stiffness, areas, potential)
    try:
        return SpectralBasis(*eigenpairs(operator, areas, k, seed), areas, mesh.vertices, components)
    except MemoryError:
        _log.warning(
            "There is not enough memory to factorise the matrix of %d vertices: its eigenfunctions are approximated "
            "on a mesh of %d.",
            len(mesh.vertices),
            COARSE_VERTICES,
        )
    # Not in the handler: its traceback keeps memory.
    pairs = _approximate_eigenpairs(mesh, operator, areas, k, seed, potential)
    return SpectralBasis(*pairs, areas, mesh.vertices, components)


def _approximate_eigenpairs(
    mesh: WorkingMesh, operator: csc_array, areas: Floats, k: int, seed: int, potential: Floats | None
) -> tuple[Floats, Floats]:
    """`eigenpairs` of an operator (n, n) on a large mesh, from the eigenfunctions of a decimated one.

    These are interpolated at the closest points, smoothed, and combined optimally (Rayleigh and Ritz), so that they are
    orthonormal and the eigenvalues are upper bounds.
    """
    points, triangles, merged = decimate(mesh.vertices, mesh.oriented_triangles, COARSE_VERTICES)
    around = Neighbourhoods(triangles, len(points))
    triangle, barycentric = project_to_embedding(mesh.vertices, points, around, merged)
    if potential is not None:  # area-weighted means
        of_coarse = segment_sum(areas, merged)
        potential = segment_sum(areas * potential, merged) / of_coarse
    coarse_stiffness, coarse_areas = mesh_laplacian(points, triangles)
    coarse_operator = _with_potential(coarse_stiffness, coarse_areas, potential)
    _, coarse = eigenpairs(coarse_operator, coarse_areas, int(SURPLUS * k) + 2, seed)
    functions = np.einsum("nc,nck->nk", barycentric, coarse[triangles[triangle]])
    damped_inverse = JACOBI_DAMPING / operator.diagonal()[:, None]
    for _ in range(JACOBI_STEPS):
        functions -= damped_inverse * (operator @ functions)
    weighted = areas[:, None] * functions
    eigenvalues, mixing = eigh(functions.T @ (operator @ functions), functions.T @ weighted, subset_by_index=(0, k - 1))
    return np.maximum(eigenvalues, 0), functions @ mixing


def _with_potential(stiffness: csc_array, areas: Floats, potential: Floats | None) -> csc_array:
    return stiffness if potential is None else csc_array(stiffness + diags_array(potential * areas))


def working_basis(mesh: WorkingMesh, k: int, seed: int = 0) -> SpectralBasis:
    """The first `k` eigenfunctions of a working mesh."""
    stiffness, areas = mesh_laplacian(mesh.vertices, mesh.triangles)
    eigenvalues, eigenvectors = eigenpairs(stiffness, areas, k, seed)
    return SpectralBasis(eigenvalues, eigenvectors, areas, mesh.vertices)
