# SPDX-License-Identifier: GPL-3.0-or-later
"""Gradients at vertices are exact for linear functions on a plane, and their divergence is that of the stiffness."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, csr_array
from transfer_meshes import globe, plate

from zoomout_core.geometry.gradients import divergence_matrices, gradient_matrices, products_of_gradients
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral.laplacian import mesh_laplacian

SLOPE = np.array([0.3, -1.2, 0.7])


def test_gradients_of_linear_functions_on_a_plane_are_exact() -> None:
    surface = plate(9, 7, jitter=0.2)
    gradient = np.column_stack([along @ (surface.vertices @ SLOPE) for along in gradient_matrices(*_arrays(surface))])
    np.testing.assert_allclose(gradient, np.broadcast_to(SLOPE * (1, 1, 0), gradient.shape), atol=1e-12)


def test_gradients_on_a_sphere_are_tangential() -> None:
    surface, _ = globe(80, 60)
    outward = surface.vertices / np.linalg.norm(surface.vertices, axis=1)[:, None]
    gradient = np.column_stack([along @ (surface.vertices @ SLOPE) for along in gradient_matrices(*_arrays(surface))])
    expected = SLOPE - (outward @ SLOPE)[:, None] * outward
    assert np.linalg.norm(gradient - expected, axis=1).max() < 0.02


def test_vertices_without_an_area_have_no_gradient() -> None:
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]])
    matrices = gradient_matrices(line, np.array([[0, 1, 2], [0, 1, 3]]))
    assert all(np.isfinite(along.data).all() for along in matrices)
    assert all((along @ line)[2].tolist() == [0, 0, 0] for along in matrices)


def test_divergence_of_a_gradient_is_the_laplacian() -> None:
    surface, _ = globe(20, 14)
    stiffness = csr_array(mesh_laplacian(*_arrays(surface))[0])
    row, column = np.repeat(np.arange(len(surface.vertices)), np.diff(stiffness.indptr)), stiffness.indices
    steps = surface.vertices[row] - surface.vertices[column]
    divergence = sum(
        along @ np.full(len(surface.vertices), slope)
        for along, slope in zip(divergence_matrices(stiffness, steps), SLOPE, strict=True)
    )
    np.testing.assert_allclose(divergence, stiffness @ (surface.vertices @ SLOPE), atol=1e-12)


def test_products_of_gradients_are_integrated_over_the_areas_of_vertices() -> None:
    mesh = plate(20, 20, jitter=0.1)
    stiffness, areas = mesh_laplacian(*_arrays(mesh))
    slopes = np.array([[2.0, 1], [0, 3], [-1, 1]])
    found = products_of_gradients(csc_array(stiffness), mesh.vertices[:, :2] @ slopes.T, mesh.vertices[:, :2])
    np.testing.assert_allclose(found.sum(axis=0), slopes * areas.sum(), atol=1e-9)
    x, y = mesh.vertices[:, :2].T
    inner = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y)) > 0.1
    np.testing.assert_allclose(found[inner].sum(axis=0), slopes * areas[inner].sum(), atol=0.01)


def _arrays(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    return surface.vertices, surface.triangles
