# SPDX-License-Identifier: GPL-3.0-or-later
"""Thin-plate splines: exact for affine maps, close to smooth ones, with the derivatives of the deformation."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.arrays import Floats
from zoomout_core.geometry.thin_plate import ThinPlateBasis, ThinPlateFit
from zoomout_core.mesh.triangles import cross, unit_vectors


@pytest.fixture
def points() -> Floats:
    return np.random.default_rng(0).uniform(-1, 1, (400, 3))


def fit(points: Floats, goals: Floats, stiffness: float) -> ThinPlateFit:
    basis = ThinPlateBasis(points[:60])
    return ThinPlateFit.of(basis, basis.at(points), goals, np.tile(np.eye(3), (len(points), 1, 1)), stiffness)


def smooth(points: Floats) -> Floats:
    return points + 0.1 * np.sin(2 * points[:, [1, 2, 0]])


def test_affine_maps_are_exact_at_high_stiffness(points: Floats) -> None:
    goals = points @ np.array([[2.0, 0.1, 0], [0, 1, 0.3], [0.2, 0, -1]]) + [1, 2, 3]
    assert fit(points, goals, 1e6).deform(points[::7]) == pytest.approx(goals[::7], abs=1e-6)


def test_smooth_deformations_are_fitted_and_stiffness_reduces_noise(points: Floats) -> None:
    new = np.random.default_rng(1).uniform(-0.8, 0.8, (50, 3))
    assert np.abs(fit(points, smooth(points), 1e-6).deform(new) - smooth(new)).max() < 0.02
    noisy = smooth(points) + 0.05 * np.random.default_rng(2).standard_normal(points.shape)
    loose, stiff = (np.abs(fit(points, noisy, each).deform(new) - smooth(new)).mean() for each in (1e-6, 1.0))
    assert stiff < 0.9 * loose


def test_normals_follow_the_surface_and_stay_outside_when_reflected(points: Floats) -> None:
    at = points[100:120]  # away from the centres, where the spline has no derivative
    for sign in (1.0, -1.0):
        found = fit(points, smooth(points) * [sign, 1, 1], 1e-6)
        tangents, step = np.eye(3)[[0, 1]], 1e-4
        moved = [found.deform(at + step * each) - found.deform(at) for each in tangents]
        normals = found.turn(at, np.tile([0.0, 0, 1], (20, 1)))
        assert normals == pytest.approx(sign * unit_vectors(cross(*moved)), abs=1e-3)


def test_scalar_weights_equal_multiples_of_the_identity(points: Floats) -> None:
    basis, weights = ThinPlateBasis(points[:60]), np.random.default_rng(3).uniform(0, 1, len(points))
    given = basis, basis.at(points), smooth(points)
    one = ThinPlateFit.of(*given, weights, 1e-3)
    other = ThinPlateFit.of(*given, weights[:, None, None] * np.eye(3), 1e-3)
    assert one.deform(points[::9]) == pytest.approx(other.deform(points[::9]), abs=1e-7)


def test_bending_energy_is_quadratic_in_the_deformation(points: Floats) -> None:
    bends = [fit(points, points + size * (smooth(points) - points), 1e-6).bending_energy for size in (0.0, 1.0, 3.0)]
    assert bends[0] == pytest.approx(0, abs=1e-9)
    assert bends[2] == pytest.approx(9 * bends[1], rel=1e-3)
