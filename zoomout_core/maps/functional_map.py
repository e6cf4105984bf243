# SPDX-License-Identifier: GPL-3.0-or-later
"""Functional maps: linear maps from functions on the source to functions on the target.

Ovsjanikov et al., Functional maps (2012). Here C has shape (k_target, k_source). For the pointwise map T from target to
source, C = Phi_target' A_target Phi_source[T].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats, Integers, check_counts, to_array
from zoomout_core.geometry.embedded_surface import Neighbourhoods, project_to_embedding
from zoomout_core.maps.anchors import coordinates
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.shapes import ShapeLike, as_surface
from zoomout_core.spectral.eigenbasis import SpectralBasis


def functional_map_of(
    pointwise: ArrayLike | SurfaceMap,
    basis_source: SpectralBasis,
    basis_target: SpectralBasis,
    k_source: int | None = None,
    k_target: int | None = None,
) -> Floats:
    """The functional map of a pointwise map, weighted by the target's areas.

    Args:
        pointwise: (n_t,) source vertex of each target vertex, or a map to points of the source.
        basis_source: basis of the surface that the map lands on.
        basis_target: basis of the surface that the map starts from.
        k_source: number of the source's functions; None for all.
        k_target: number of the target's functions; None for all.

    Returns:
        (k_target, k_source) functional map.

    Raises:
        ValueError: the map is not between these shapes, or the bases have fewer functions.

    Example:
        >>> zo.functional_map_of(truth, *bases, 20, 20).shape
        (20, 20)
    """
    k_source = len(basis_source.eigenvalues) if k_source is None else k_source
    k_target = len(basis_target.eigenvalues) if k_target is None else k_target
    check_fits_bases((k_target, k_source), basis_source, basis_target)
    n_source, n_target = len(basis_source.areas), len(basis_target.areas)
    if isinstance(pointwise, SurfaceMap):
        if len(pointwise.triangle) != n_target or pointwise.source_triangles.max() >= n_source:
            raise ValueError(
                f"The map has {len(pointwise.triangle)} vertices, which does not fit {n_source} source and "
                f"{n_target} target vertices: give the map of these shapes."
            )
        images = pointwise.interpolate(basis_source.eigenvectors[:, :k_source])
    else:
        images = basis_source.eigenvectors[check_vertices(pointwise, n_source, n_target), :k_source]
    return basis_target.eigenvectors[:, :k_target].T @ (basis_target.areas[:, None] * images)


def vertex_map_of(functional_map: ArrayLike, basis_source: SpectralBasis, basis_target: SpectralBasis) -> Integers:
    """(n_t,) vertex map of a functional map (k_t, k_s), by the conversion of ZoomOut.

    Each target vertex is mapped to the source vertex whose row of Phi_source C' is nearest to its row of Phi_target.

    Raises:
        ValueError: the functional map is invalid or larger than the bases.

    Example:
        >>> zo.vertex_map_of(np.eye(20), bases[0], bases[0]).shape == (len(source.vertices),)
        True
    """
    return nearest(*_embeddings(functional_map, basis_source, basis_target))


def precise_map_of(
    functional_map: ArrayLike, basis_source: SpectralBasis, basis_target: SpectralBasis, source: ShapeLike
) -> SurfaceMap:
    """Convert a functional map (k_t, k_s) to the precise map, to points of the source's triangles.

    Ezuz and Ben-Chen, Deblurring and denoising of maps between shapes (2017): each row of Phi_target is projected onto
    the source's triangles, with the rows of Phi_source C' as vertices. Triangles around the nearest vertex are tested.

    Args:
        functional_map: map from functions of the source to functions of the target.
        basis_source: basis of the surface that the map lands on.
        basis_target: basis of the surface that the map starts from.
        source: the surface of the source's basis.

    Raises:
        ValueError: the functional map is invalid or larger than the bases, or the source's basis is of another shape.

    Example:
        >>> zo.precise_map_of(np.eye(20), bases[0], bases[0], source).barycentric.shape == source.vertices.shape
        True
    """
    surface = as_surface(source)
    if len(surface.vertices) != len(basis_source.areas):
        raise ValueError(
            f"The source has {len(surface.vertices)} vertices, but its basis was computed for "
            f"{len(basis_source.areas)}: give the basis of this source."
        )
    queries, embedded = _embeddings(functional_map, basis_source, basis_target)
    # Triangles of the welded mesh are neighbours across coincident borders.
    working = surface.working
    embedded = embedded[working.surface_vertex]
    around = Neighbourhoods(working.triangles, len(embedded))
    triangle, barycentric = project_to_embedding(queries, embedded, around, nearest(queries, embedded))
    return SurfaceMap(working.triangle_of[triangle], barycentric, surface.triangles)


def _embeddings(
    functional_map: ArrayLike, basis_source: SpectralBasis, basis_target: SpectralBasis
) -> tuple[Floats, Floats]:
    """Embeddings (n_t, k_t) of the target's vertices and (n_s, k_t) of the source's; corresponding ones are close."""
    C = check_functional_map(functional_map)
    check_fits_bases(C.shape, basis_source, basis_target)
    return coordinates(basis_target.eigenvectors, basis_source.eigenvectors, C)


def check_vertices(vertex: ArrayLike, n_source: int, n_target: int) -> Integers:
    """Check a user's vertex map (n_t,).

    Raises:
        ValueError: it does not have one of n_source source vertices for each of n_target target vertices.
    """
    if np.ndim(vertex) == 1 and np.size(vertex) != n_target:
        raise ValueError(
            f"A vertex map must give one of {n_source} source vertices for each of {n_target} target vertices, not "
            f"for {np.size(vertex)}."
        )
    return vertex_numbers(vertex, n_source, "Images on the source")


def check_functional_map(functional_map: ArrayLike) -> Floats:
    """Check a user's functional map (k_t, k_s).

    Raises:
        ValueError: it is not a matrix of finite numbers.
    """
    C = to_array(functional_map, "A functional map")
    if C.ndim != 2 or C.size == 0:
        raise ValueError(f"A functional map must be a matrix, not of shape {C.shape}.")
    if C.dtype.kind not in "iuf" or not np.isfinite(C).all():
        raise ValueError("A functional map must consist of finite numbers: correct it.")
    return C


def check_fits_bases(size: tuple[int, ...], basis_source: SpectralBasis, basis_target: SpectralBasis) -> None:
    """Raise ValueError unless the bases have enough functions for a map of this size (k_target, k_source)."""
    check_counts(k_target=size[0], k_source=size[1])
    available = len(basis_target.eigenvalues), len(basis_source.eigenvalues)
    if size[0] > available[0] or size[1] > available[1]:
        raise ValueError(
            f"A functional map of {size[0]} target and {size[1]} source functions is larger than the bases of "
            f"{available[0]} and {available[1]}: compute more eigenfunctions."
        )


def _shape_beside(functional_map: Floats, eigenvalues_source: Floats, eigenvalues_target: Floats) -> tuple[int, int]:
    """The shape of C, after checking it against the eigenvalues."""
    shapes = np.shape(functional_map), np.shape(eigenvalues_target), np.shape(eigenvalues_source)
    if [len(shape) for shape in shapes] != [2, 1, 1] or not all(
        0 < size <= count for size, (count,) in zip(shapes[0], shapes[1:], strict=True)
    ):
        raise ValueError(
            f"A functional map of shape {shapes[0]} does not fit eigenvalues of shapes {shapes[2]} of the source and "
            f"{shapes[1]} of the target: give a matrix (k_target, k_source), and as many eigenvalues of each."
        )
    k_target, k_source = shapes[0]
    return k_target, k_source


def commutativity_error(functional_map: Floats, eigenvalues_source: Floats, eigenvalues_target: Floats) -> float:
    """||Lambda_target C - C Lambda_source||, relative to the largest eigenvalue; zero for an isometry.

    Args:
        functional_map: C (k_target, k_source).
        eigenvalues_source: eigenvalues of the source, at least k_source; of more, the first count.
        eigenvalues_target: those of the target, at least k_target.

    Raises:
        ValueError: C is not a matrix, or there are fewer eigenvalues than it has columns or rows.

    Example:
        >>> C, (a, b) = zo.functional_map_of(truth, *bases, 20, 20), bases
        >>> zo.commutativity_error(C, a.eigenvalues, b.eigenvalues) > 0
        True
    """
    k_target, k_source = _shape_beside(functional_map, eigenvalues_source, eigenvalues_target)
    eigenvalues_source, eigenvalues_target = np.asarray(eigenvalues_source), np.asarray(eigenvalues_target)
    difference = eigenvalues_target[:k_target, None] - eigenvalues_source[:k_source]
    largest = max(eigenvalues_target[k_target - 1], eigenvalues_source[k_source - 1])
    return float(np.linalg.norm(difference * functional_map) / largest)


def frequency_error(functional_map: Floats, eigenvalues_source: Floats, eigenvalues_target: Floats) -> float:
    """Mean difference of the frequencies that C couples, relative to the highest; 0 for an isometry.

    A frequency is the square root of an eigenvalue. C has shape (k_target, k_source); of more eigenvalues, the first
    k count.

    Raises:
        ValueError: see `commutativity_error`.
    """
    k_target, k_source = _shape_beside(functional_map, eigenvalues_source, eigenvalues_target)
    source, target = np.sqrt(eigenvalues_source[:k_source]), np.sqrt(eigenvalues_target[:k_target])
    coupled = np.abs(target[:, None] - source) * np.abs(functional_map)
    return float(coupled.sum() / (k_target * max(source[-1], target[-1])))


def orthonormality_error(functional_map: Floats) -> float:
    """ZoomOut's energy of C (k_target, k_source): the sum of ||C_k' C_k - I||^2 / k over its leading k x k blocks.

    Example:
        >>> zo.orthonormality_error(np.eye(10))
        0.0
    """
    functional_map, energy = check_functional_map(functional_map), 0.0
    for k in range(1, min(functional_map.shape) + 1):
        block = functional_map[:k, :k]
        energy += float(np.linalg.norm(block.T @ block - np.eye(k)) ** 2) / k
    return energy


def eigenvalue_mask(eigenvalues_source: Floats, eigenvalues_target: Floats) -> Floats:
    """(k_t, k_s) squared differences of eigenvalues, scaled to mean one in each row."""
    return _of_mean_one((eigenvalues_target[:, None] - eigenvalues_source) ** 2)


def resolvent_mask(eigenvalues_source: Floats, eigenvalues_target: Floats) -> Floats:
    """(k_t, k_s) distances of the resolvents of eigenvalues (exponent 1/2), scaled to mean one in each row."""
    largest = max(eigenvalues_source[-1], eigenvalues_target[-1])
    relative = eigenvalues_source / largest, eigenvalues_target / largest
    source, target = (np.stack([np.sqrt(each), np.ones_like(each)]) / (1 + each) for each in relative)
    return _of_mean_one(((target[:, :, None] - source[:, None]) ** 2).sum(axis=0))


def _of_mean_one(mask: Floats) -> Floats:
    return np.asarray(mask / mask.mean(axis=1, keepdims=True))
