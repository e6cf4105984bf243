# SPDX-License-Identifier: GPL-3.0-or-later
"""PFM and LMH: gradients and tiny cases solved by hand, and easy pairs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex

import zoomout_core as zo
from benchmarks.baselines import pfm as module
from benchmarks.baselines.bcicp import Side
from benchmarks.baselines.lmh import kernels, lmh, localized_harmonics, transport
from benchmarks.baselines.pfm import (
    MapEnergy,
    RegionEnergy,
    closest_points,
    gradient_operator,
    lengths,
    orthonormal_rows,
    pfm,
    slant,
)
from zoomout_core.arrays import Floats
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.grids import grid_faces
from zoomout_core.spectral.eigenbasis import SpectralBasis

K = 40


@pytest.fixture(scope="module")
def whole() -> Creature:
    return creature(1500, seed=0, asymmetry=0.3)


@pytest.fixture(scope="module")
def half(whole: Creature) -> tuple[Surface, np.ndarray]:
    """The side of a bent creature with one more limb, and the corresponding vertices of the whole."""
    bent = creature(1400, seed=1, bend=0.5, asymmetry=0.3)
    inside = (bent.directions[:, 0] > -0.2)[bent.surface.triangles].all(axis=1)
    used, triangles = np.unique(bent.surface.triangles[inside], return_inverse=True)
    part = Surface(bent.surface.vertices[used], triangles.reshape(-1, 3))
    return part, true_vertex(whole, bent)[used]


def off(vertex: np.ndarray, truth: np.ndarray, source: Surface) -> float:
    return float(zo.geodesic_error(vertex, source, np.arange(len(truth)), truth, 300).mean())


def check_gradient(at: Callable[[Floats], tuple[float, Floats]], x: Floats) -> None:
    """Compare a gradient with central differences along a random direction."""
    direction = np.random.default_rng(1).standard_normal(x.shape)
    step = 1e-6 * direction
    slope = (at(x + step)[0] - at(x - step)[0]) / 2e-6
    assert abs(slope) > 1e-3
    assert (at(x)[1] * direction).sum() == pytest.approx(slope, rel=1e-4)


# --- PFM ----------------------------------------------------------------------------------------------------


def test_gradients_match_the_energies(whole: Creature, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    fit = MapEnergy(random.standard_normal((8, 12)), slant(8, 5), 5)
    check_gradient(lambda C: fit.at(C, np.ones((8, 12))), random.standard_normal((8, 8)))
    monkeypatch.setattr(module, "LENGTH", 1.0)  # which weighs as much as the rest
    side = Side(whole.surface, zo.eigenbasis(whole.surface, 8))
    place = RegionEnergy.of(side, random.standard_normal((1500, 12)), 0.4, 8)
    check_gradient(lambda v: place.at(v, np.ones((8, 12))), random.random(1500))


def test_ideal_map_has_only_the_slant_energy() -> None:
    # Two of three rows orthonormal, along the diagonal of slope 2 / 3, and descriptors that agree.
    C = np.eye(3)[[0, 1, 2]] * [[1], [1], [0]]
    fit = MapEnergy(np.eye(3), slant(3, 2), 2)
    energy = fit.at(C, C.T @ np.eye(3))[0]
    assert slant(3, 2)[0, 0] == 0
    assert slant(3, 2)[1, 1] == pytest.approx(np.exp(-0.03 * np.sqrt(2)) / np.sqrt(13))
    assert energy == pytest.approx(module.SLANT * slant(3, 2)[1, 1] ** 2 + 3 * module.SMOOTHING)
    # A row of twice the length is off by 3 in the squared norm.
    longer = fit.at(C * [[2], [1], [1]], (C * [[2], [1], [1]]).T)[0]
    assert longer - energy == pytest.approx(module.ORTHOGONALITY * 9)


def test_lengths_sum_over_columns() -> None:
    total, directions = lengths(np.array([[3.0, 0], [4, 2]]))
    assert total == pytest.approx(7)
    np.testing.assert_allclose(directions, [[0.6, 0], [0.8, 1]])


def test_the_gradient_of_a_coordinate_lies_in_the_triangle() -> None:
    triangle = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0]])
    gradient = gradient_operator(triangle, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(gradient @ triangle, np.diag([1.0, 1, 0]), atol=1e-12)


def test_region_border_has_its_length() -> None:
    """On a unit square, v rises linearly from 0 to 1 in the middle between the two halves."""
    side = np.linspace(0, 1, 101)
    points = np.stack(np.meshgrid(side, side, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    quads = grid_faces(100, 100)
    triangles = np.concatenate([quads[:, [0, 1, 3]], quads[:, [3, 1, 2]]])
    basis = SpectralBasis(np.zeros(1), np.ones((101**2, 1)), np.full(101**2, 101.0**-2), points)
    place = RegionEnergy.of(Side(Surface(points, triangles), basis), np.zeros((101**2, 1)), 0.5, 1)
    # The Gaussian about 1/2 has 98.8 % of its mass within 0 and 1, 2.5 standard deviations.
    assert place._border(np.clip(4 * points[:, 0] - 1.5, 0, 1))[0] == pytest.approx(0.988, abs=0.03)
    assert place._border(np.ones(101**2))[0] < 0.01


def test_nearest_orthonormal_rows_ignore_stretching() -> None:
    rows = np.eye(3)[:2]
    np.testing.assert_allclose(orthonormal_rows(np.diag([2.0, 5]) @ rows), rows, atol=1e-12)


def test_closest_points_turn_a_circle_into_place() -> None:
    angles = np.arange(8) * np.pi / 4
    points = np.column_stack([np.cos(angles), np.sin(angles)]) / 2  # orthonormal with areas of one
    basis = SpectralBasis(np.ones(2), points, np.ones(8), np.zeros((8, 3)))
    turned = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    C, vertex = closest_points(turned, points, basis, 3)
    np.testing.assert_array_equal(vertex, range(8))
    np.testing.assert_allclose(C, np.eye(2), atol=1e-12)


@pytest.mark.slow
def test_a_part_is_found_with_its_region(whole: Creature, half: tuple[Surface, np.ndarray]) -> None:
    part, truth = half
    source, target = (Side(surface, zo.eigenbasis(surface, K)) for surface in (whole.surface, part))
    # Descriptors that distinguish places: smooth functions of them.
    places = whole.directions
    descriptors = np.column_stack([np.exp(-4 * ((places - place) ** 2).sum(axis=1)) for place in places[::25]])
    random = np.random.default_rng(0)
    noisy = descriptors[truth] + 0.05 * random.standard_normal((len(truth), descriptors.shape[1]))
    found = pfm(source, target, descriptors, noisy, K)
    # The error is 0.026 to 0.039 over four draws of the noise. Descriptors with so little noise alone have 0.025 to
    # 0.027, so the assertions on the region below are the ones that test `pfm`.
    assert off(found.vertex, truth, whole.surface) < 0.06
    inside = places[:, 0] > -0.2
    assert found.region[inside].mean() > 0.75
    assert found.region[~inside].mean() < 0.35
    np.testing.assert_allclose(
        found.functional_map @ found.functional_map.T, np.eye(len(found.functional_map)), atol=1e-9
    )


# --- LMH ----------------------------------------------------------------------------------------------------


def test_localized_harmonics_are_local_and_orthogonal_to_basis(whole: Creature) -> None:
    outside = (whole.directions[:, 0] < 0.1).astype(float)
    low = zo.eigenbasis(whole.surface, 10)
    harmonics = localized_harmonics(whole.surface, low, outside, 12)
    areas = harmonics.areas
    np.testing.assert_allclose(harmonics.coefficients(harmonics.eigenvectors), np.eye(12), atol=1e-6)
    assert (np.diff(harmonics.eigenvalues) > 0).all()
    assert areas[outside > 0] @ harmonics.eigenvectors[outside > 0, 0] ** 2 < 0.2
    overlap = np.abs(low.coefficients(harmonics.eigenvectors))
    without = zo.hamiltonian_basis(whole.surface, outside, 12)
    assert overlap.max() < 0.3 < np.abs(low.coefficients(without.eigenvectors)).max()


def test_harmonics_without_region_are_eigenfunctions(whole: Creature) -> None:
    basis = zo.eigenbasis(whole.surface, 12)
    nothing = SpectralBasis(np.zeros(0), np.zeros((1500, 0)), basis.areas, basis.points)
    harmonics = localized_harmonics(whole.surface, nothing, np.zeros(1500), 12)
    np.testing.assert_allclose(harmonics.eigenvalues, basis.eigenvalues, atol=1e-4 * basis.eigenvalues[-1])


def test_functions_are_transported_by_least_squares() -> None:
    C = np.array([[0.0, 2], [1, 0]])
    functions = np.array([[1.0, 0, 1], [0, 1, 1]])
    np.testing.assert_allclose(transport(functions, C @ functions), C, rtol=0.05, atol=0.05)


def test_heat_kernels_at_matches_use_three_decays() -> None:
    basis = SpectralBasis(np.array([0.0, 2]), np.array([[1.0, 3], [1, -3]]), np.full(2, 0.5), np.zeros((2, 3)))
    of_first = kernels(basis, np.array([0]))
    np.testing.assert_allclose(of_first[0], 1)
    np.testing.assert_allclose(of_first[1], 3 * np.exp(-np.array([1, np.sqrt(10), 10])))


def test_sparse_matches_become_a_map(whole: Creature) -> None:
    other = creature(1400, seed=1, bend=0.5, asymmetry=0.3)
    truth = true_vertex(whole, other)
    on_target = np.linspace(0, 1399, 40).astype(int)
    matches = np.column_stack([on_target, truth[on_target]])
    nothing = np.zeros((1500, 0)), np.zeros((1400, 0))
    harmonics = [
        localized_harmonics(
            each.surface, SpectralBasis(np.zeros(0), rows, np.ones(len(rows)), rows), np.zeros(len(rows)), 20
        )
        for each, rows in zip((whole, other), nothing, strict=True)
    ]
    nearest_match = np.linalg.norm(other.directions[:, None] - other.directions[on_target], axis=2).argmin(axis=1)
    vertex = lmh(*harmonics, matches)
    assert off(vertex, truth, whole.surface) < min(0.1, off(matches[nearest_match, 1], truth, whole.surface))
