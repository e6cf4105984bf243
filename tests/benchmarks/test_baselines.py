# SPDX-License-Identifier: GPL-3.0-or-later
"""The methods that ZoomOut is compared with: cases solved by hand, and an easy pair that each improves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from creatures import creature, true_vertex

import zoomout_core as zo
from benchmarks.baselines import bcicp as bcicp_module
from benchmarks.baselines import rhm as rhm_module
from benchmarks.baselines.bcicp import Side, bcicp, covering, smooth_map, turn_to_inverse
from benchmarks.baselines.deblur import deblur, deblur_map
from benchmarks.baselines.kernel_matching import assign, kernel_matching
from benchmarks.baselines.rhm import Embedded, geodesic_embedding, images, rhm
from benchmarks.baselines.sampled_zoomout import sampled_zoomout
from benchmarks.baselines.spectral_icp import nearest_orthonormal, spectral_icp
from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.grids import grid_faces
from zoomout_core.spectral.eigenbasis import SpectralBasis

K = 50


def turn(degrees: float) -> np.ndarray:
    angle = np.radians(degrees)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def line(values: list[float]) -> SpectralBasis:
    """One function on some vertices."""
    rows = np.array(values)[:, None]
    return SpectralBasis(np.zeros(1), rows, np.full(len(rows), 1 / len(rows)), np.zeros((len(rows), 3)))


@pytest.fixture
def circle() -> SpectralBasis:
    """Four points evenly on a circle, with the first two functions that are not constant."""
    points = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    return SpectralBasis(np.ones(2), np.sqrt(2) * points[:, :2], np.full(4, 0.25), points)


# The last of the four points on the circle is wrong.
ONE_WRONG = np.array([0, 1, 2, 2])


def grid(size: int = 11) -> Surface:
    """A plane of squares cut in two; vertex i * size + j is at (i, j)."""
    i, j = np.divmod(np.arange(size**2), size)
    quads = grid_faces(size - 1, size - 1)
    triangles = np.concatenate([quads[:, [0, 1, 3]], quads[:, [3, 1, 2]]])
    return Surface(np.column_stack([i, j, 0 * i]).astype(float), triangles)


# --- by hand ------------------------------------------------------------------------------------------------


def test_deblurring_maps_target_functions_to_source() -> None:
    source, target, double = line([1, 2, 3, 4]), line([1, 2]), np.array([[2.0]])
    np.testing.assert_array_equal(deblur_map(double, source, target), [1, 3])  # 2 and 4 among 1, 2, 3, 4
    np.testing.assert_array_equal(vertex_map_of(double, source, target), [0, 0])  # ZoomOut: 1 and 2 among 2, 4, 6, 8


def test_nearest_orthonormal_matrix_keeps_only_the_rotation() -> None:
    np.testing.assert_allclose(nearest_orthonormal(3 * turn(40)), turn(40), atol=1e-12)
    np.testing.assert_allclose(nearest_orthonormal(np.diag([2, -0.5])), np.diag([1, -1]), atol=1e-12)


def test_icp_rotates_a_circle_by_its_functional_map(circle: SpectralBasis) -> None:
    # C = [[1, 0], [1/2, 1/2]], and the turn nearest to it is by atan((1/2 - 0) / (1 + 1/2)).
    refined = spectral_icp(circle, circle, ONE_WRONG, 2, iterations=1)
    np.testing.assert_allclose(refined.functional_map, turn(np.degrees(np.arctan(1 / 3))), atol=1e-12)
    np.testing.assert_array_equal(refined.vertex, [0, 1, 2, 3])
    again = spectral_icp(circle, circle, ONE_WRONG, 2, iterations=2)
    np.testing.assert_allclose(again.functional_map, np.eye(2), atol=1e-12)


def test_assignment_is_optimal_overall() -> None:
    np.testing.assert_array_equal(assign(np.array([[5.0, 4], [4, 1]])), [1, 0])


def test_kernel_matching_makes_a_map_bijective(circle: SpectralBasis) -> None:
    there, back = kernel_matching(circle, circle, ONE_WRONG, samples=4, times=np.array([0.1]))
    np.testing.assert_array_equal(there, range(4))
    np.testing.assert_array_equal(back, range(4))


def test_bcicp_replaces_map_by_inverse_of_reverse_map() -> None:
    np.testing.assert_allclose(turn_to_inverse(turn(30), turn(20)), turn(-20), atol=1e-12)
    np.testing.assert_allclose(turn_to_inverse(2 * turn(30), turn(20)), 2 * turn(-20), atol=1e-12)


def test_missed_vertices_are_covered_if_old_image_stays_covered() -> None:
    # Source vertex 2 is missed. Its partner 1 shares its image 0 with another and is free to go there.
    np.testing.assert_array_equal(covering(np.array([0, 0, 1]), np.array([0, 2, 1])), [0, 2, 1])
    # Partner 2 is the only one that goes to 1.
    np.testing.assert_array_equal(covering(np.array([0, 0, 1]), np.array([0, 2, 2])), [0, 0, 1])
    # Sources 2 and 3 are missed and want the same partner: the first gets it.
    np.testing.assert_array_equal(covering(np.array([0, 0, 1]), np.array([0, 2, 1, 1])), [0, 2, 1])


def test_smoothing_removes_outliers() -> None:
    plane = grid()
    vertex = np.arange(121)
    np.testing.assert_array_equal(smooth_map(vertex, plane, plane), vertex)
    torn = np.where(vertex == 60, 0, vertex)  # the middle goes to a corner
    mended = smooth_map(torn, plane, plane)
    assert mended[60] in (49, 50, 59, 61, 70, 71)
    np.testing.assert_array_equal(np.delete(mended, 60), np.delete(vertex, 60))


def test_isolated_jump_takes_median_of_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bcicp_module, "OUTLIERS", 0.0)
    plane = grid()
    torn = np.where(np.arange(121) == 60, 0, np.arange(121))
    mended = smooth_map(torn, plane, plane)
    # The neighbours' images are a hexagon, drawn out along one diagonal of the squares: its far corners are not median.
    assert mended[60] in (49, 59, 61, 71)
    np.testing.assert_array_equal(np.delete(mended, 60), np.delete(np.arange(121), 60))


def test_rhm_images_shrink_by_the_harmonic_factor() -> None:
    ball = Embedded.of(creature(300).surface)
    basis = zo.eigenbasis(ball.surface, 4)
    # With the identity both ways, (alpha W + (beta + 1 - alpha) A) Y = (beta + 1 - alpha) A X; for W X = lambda A X
    # this is Y = X (beta + 1 - alpha) / (alpha lambda + beta + 1 - alpha).
    ball = replace(ball, positions=basis.eigenvectors)
    same = ball.matrix(zo.SurfaceMap.from_vertices(np.arange(300), ball.surface))
    kept = 0.5 + 1 - rhm_module.ALPHA
    expected = basis.eigenvectors * (kept / (rhm_module.ALPHA * basis.eigenvalues + kept))
    np.testing.assert_allclose(images(ball, ball, same, same, 0.5), expected, atol=1e-8)


def test_geodesic_embedding_of_tetrahedron_keeps_edge_lengths() -> None:
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    places = geodesic_embedding(Surface(corners, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]), dimension=3)
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    # Four faces of sqrt(3) / 4 for edges of length one.
    np.testing.assert_allclose(apart, (1 - np.eye(4)) / 3**0.25, atol=1e-9)


# --- an easy pair -------------------------------------------------------------------------------------------


class Easy:
    """Two poses of a creature on different meshes, with rough initial maps in both directions."""

    def __init__(self) -> None:
        source, target = creature(1200, 0, asymmetry=0.1), creature(1100, 1, bend=0.5, asymmetry=0.1)
        self.source, self.target = (Side(c.surface, zo.eigenbasis(c.surface, K)) for c in (source, target))
        self.bases = self.source.basis, self.target.basis
        self.truth = true_vertex(source, target)
        self.initial = rough(self.truth, *self.bases)
        self.initial_back = rough(true_vertex(target, source), *self.bases[::-1])

    def error(self, vertex: np.ndarray) -> float:
        """Mean geodesic error, times 1000."""
        errors = zo.geodesic_error(vertex, self.source.surface, np.arange(len(self.truth)), self.truth)
        return float(1000 * errors.mean())


def rough(vertex: np.ndarray, basis_source: SpectralBasis, basis_target: SpectralBasis) -> np.ndarray:
    """A vertex map projected to 8 functions, with three of ten vertices mapped at random."""
    known = functional_map_of(vertex, basis_source, basis_target, 8, 8)
    random = np.random.default_rng(0)
    anywhere = random.integers(len(basis_source.areas), size=len(vertex))
    return np.where(random.random(len(vertex)) < 0.3, anywhere, vertex_map_of(known, basis_source, basis_target))


@pytest.fixture(scope="module")
def easy() -> Easy:
    return Easy()


METHODS: dict[str, Callable[[Easy], np.ndarray]] = {
    "deblur": lambda easy: deblur(*easy.bases, easy.initial, 10, K).vertex,
    "icp": lambda easy: spectral_icp(*easy.bases, easy.initial, 20).vertex,
    "pmf": lambda easy: kernel_matching(*easy.bases, easy.initial, samples=200)[0],
    "bcicp": lambda easy: bcicp(easy.source, easy.target, easy.initial, easy.initial_back, 20)[0].vertex,
    "sampled": lambda easy: sampled_zoomout(*easy.bases, easy.initial, K, 2, 200, 10).vertex,
    "rhm": lambda easy: rhm(easy.source.surface, easy.target.surface, easy.initial, easy.initial_back, 10)[0],
}


@pytest.mark.parametrize("name", METHODS)
def test_each_method_improves_its_start(easy: Easy, name: str) -> None:
    vertex = METHODS[name](easy)
    assert vertex.shape == easy.initial.shape
    assert easy.error(easy.initial) > 100
    assert easy.error(vertex) < 55


def test_sampled_zoomout_takes_a_functional_map_or_a_vertex_map(easy: Easy) -> None:
    start = functional_map_of(easy.initial, *easy.bases, 10, 10)
    refined = [sampled_zoomout(*easy.bases, each, K, 5, 200, 10) for each in (start, easy.initial)]
    np.testing.assert_array_equal(refined[0].vertex, refined[1].vertex)
    assert refined[0].functional_map.shape == (K, K)
