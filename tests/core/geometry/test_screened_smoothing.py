# SPDX-License-Identifier: GPL-3.0-or-later
"""Screened smoothing of values over a mesh, with weights."""

from __future__ import annotations

import numpy as np
from transfer_meshes import sphere

from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing, screened_stiffness
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.spectral.laplacian import mesh_laplacian

MESH = sphere(unit_vectors(np.random.default_rng(1).normal(size=(200, 3))))
STIFFNESS, AREAS = mesh_laplacian(MESH.vertices, MESH.triangles)
VALUES = np.random.default_rng(0).normal(size=(len(AREAS), 2))


def test_smoothing_solves_the_screened_poisson_equation() -> None:
    smoothing = ScreenedSmoothing.of(AREAS, STIFFNESS, 0.3)
    matrix = np.diag(AREAS) + 0.3**2 * STIFFNESS.toarray()
    np.testing.assert_allclose(screened_stiffness(AREAS, STIFFNESS, 0.3).toarray(), matrix, atol=1e-15)
    smooth = np.linalg.solve(matrix, AREAS[:, None] * VALUES)
    np.testing.assert_allclose(smoothing.smooth(VALUES), smooth, atol=1e-10)
    divergence = STIFFNESS @ VALUES[:, ::-1]
    fitted = np.linalg.solve(matrix, AREAS[:, None] * VALUES + 0.3**2 * divergence)
    np.testing.assert_allclose(smoothing.fit(VALUES, divergence), fitted, atol=1e-10)


def test_smoothing_keeps_constants_and_converges_to_the_mean() -> None:
    smoothing = ScreenedSmoothing.of(AREAS, STIFFNESS, 0.3)
    np.testing.assert_allclose(smoothing.smooth(np.ones((len(AREAS), 1))), 1, atol=1e-10)
    mean = AREAS @ VALUES
    np.testing.assert_allclose(AREAS @ smoothing.smooth(VALUES), mean, atol=1e-10)
    long = ScreenedSmoothing.of(AREAS, STIFFNESS, 1e4)
    np.testing.assert_allclose(long.smooth(VALUES), np.broadcast_to(mean, VALUES.shape), atol=1e-6)


def test_fit_keeps_values_given_their_own_gradients() -> None:
    smoothing = ScreenedSmoothing.of(AREAS, STIFFNESS, 0.3)
    np.testing.assert_allclose(smoothing.fit(VALUES, STIFFNESS @ VALUES), VALUES, atol=1e-10)
