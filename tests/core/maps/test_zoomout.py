# SPDX-License-Identifier: GPL-3.0-or-later
"""The implementation has the theoretical properties of functional maps and ZoomOut."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex

from zoomout_core import (
    commutativity_error,
    eigenbasis,
    geodesic_error,
    orthonormality_error,
    slanted_sizes,
    zoomout,
    zoomout_both_ways,
)
from zoomout_core.maps.functional_map import frequency_error, functional_map_of, vertex_map_of
from zoomout_core.maps.nearest import MIN_CLUSTERED_PAIRS, nearest, nearest_among
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.sampling import farthest_points


@pytest.fixture(scope="module")
def small() -> Creature:
    return creature(2500)


@pytest.fixture(scope="module")
def basis(small: Creature) -> SpectralBasis:
    return eigenbasis(small.surface, 100)


@pytest.fixture(scope="module")
def moved(small: Creature) -> tuple[Surface, np.ndarray]:
    """A permuted, rigidly moved and rescaled copy, and the original vertex of each of its vertices."""
    random = np.random.default_rng(3)
    order = random.permutation(len(small.surface.vertices))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    vertices = (small.surface.vertices @ rotation * 37 + [1, 2, 3])[order]
    return Surface(vertices, place[small.surface.triangles]), order


@pytest.fixture(scope="module")
def moved_basis(moved: tuple[Surface, np.ndarray]) -> SpectralBasis:
    return eigenbasis(moved[0], 100)


@pytest.fixture(scope="module")
def resting_basis(resting: Creature) -> SpectralBasis:
    return eigenbasis(resting.surface, 100)


def test_the_functional_map_of_the_identity_is_the_identity(basis: SpectralBasis) -> None:
    identity = np.arange(len(basis.areas))
    np.testing.assert_allclose(functional_map_of(identity, basis, basis, 100, 100), np.eye(100), atol=1e-5)
    assert np.array_equal(vertex_map_of(np.eye(100), basis, basis), identity)


def test_an_isometry_has_a_diagonal_orthonormal_functional_map(basis, moved, moved_basis) -> None:
    C = functional_map_of(moved[1], basis, moved_basis, 60, 60)
    assert orthonormality_error(C) < 1e-6
    assert commutativity_error(C, basis.eigenvalues, moved_basis.eigenvalues) < 1e-4
    np.testing.assert_allclose(np.abs(C), np.eye(60), atol=2e-2)
    random = functional_map_of(np.random.default_rng(0).permutation(moved[1]), basis, moved_basis, 60, 60)
    assert orthonormality_error(random) > 1
    assert commutativity_error(random, basis.eigenvalues, moved_basis.eigenvalues) > 0.1


@pytest.mark.parametrize("samples", [None, 400])
def test_a_moved_copy_is_recovered_exactly_from_a_small_map(basis, moved, moved_basis, samples) -> None:
    C = functional_map_of(moved[1], basis, moved_basis, 6, 6)
    refined = zoomout(basis, moved_basis, C, k_final=100, step=5, samples=samples)
    assert refined.functional_map.shape == (100, 100)
    assert np.array_equal(refined.vertex, moved[1])


def test_swapping_the_shapes_inverts_a_bijection(basis, moved, moved_basis) -> None:
    C = functional_map_of(moved[1], basis, moved_basis, 10, 10)
    there = zoomout(basis, moved_basis, C, k_final=80)
    back = zoomout(moved_basis, basis, C.T, k_final=80)
    assert np.array_equal(there.vertex[back.vertex], np.arange(len(there.vertex)))


@pytest.mark.slow
def test_refinement_improves_coarse_map_across_pose_and_topology(resting, bent, resting_basis) -> None:
    other = eigenbasis(bent.surface, 100)
    truth = true_vertex(resting, bent)
    C = functional_map_of(truth, resting_basis, other, 8, 8)
    everywhere = np.arange(len(truth))

    def error(vertex: np.ndarray) -> float:
        return float(geodesic_error(vertex, resting.surface, everywhere, truth).mean())

    initial = error(vertex_map_of(C, resting_basis, other))
    full = error(zoomout(resting_basis, other, C, k_final=100, samples=None).vertex)
    sampled = error(zoomout(resting_basis, other, C, k_final=100, samples=500).vertex)
    assert full < 0.6 * initial
    assert sampled < 1.1 * full


@pytest.mark.parametrize("samples", [None, 500])
@pytest.mark.parametrize(("size", "final"), [((20, 24), (60, 64)), ((24, 20), (64, 60))])
def test_rectangular_initial_map_stays_rectangular(basis, moved_basis, moved, samples, size, final) -> None:
    C = functional_map_of(moved[1], basis, moved_basis, size[1], size[0])
    refined = zoomout(basis, moved_basis, C, k_final=64, samples=samples)
    assert refined.functional_map.shape == final
    assert (refined.vertex == moved[1]).mean() > 0.99


@pytest.mark.parametrize("samples", [None, 300])
def test_evenly_growing_sizes_equal_the_default_ones(basis, moved_basis, moved, samples) -> None:
    C, vertex = functional_map_of(moved[1], basis, moved_basis, 10, 10), np.roll(moved[1], 1)
    for start, sizes in ((C, range(15, 41, 5)), (vertex, [20, (25, 25), *range(30, 41, 5)])):
        usual = zoomout(basis, moved_basis, start, k_final=40, samples=samples)
        chosen = zoomout(basis, moved_basis, start, samples=samples, sizes=sizes)
        assert np.array_equal(chosen.functional_map, usual.functional_map)
        assert np.array_equal(chosen.vertex, usual.vertex)


@pytest.mark.parametrize("samples", [None, 60])
@pytest.mark.parametrize("sizes", [[(30, 10)], [50, (20, 40), (37, 53)], np.array([[30, 20], [24, 28]])])
def test_refined_map_has_the_last_of_the_given_sizes(basis, moved_basis, moved, sizes, samples) -> None:
    for start in (functional_map_of(moved[1], basis, moved_basis, 10, 12), moved[1]):
        refined = zoomout(basis, moved_basis, start, sizes=sizes, samples=samples)
        assert refined.functional_map.shape == tuple(sizes[-1])


def test_samples_can_be_given_as_vertices(basis, moved_basis, moved) -> None:
    C = functional_map_of(moved[1], basis, moved_basis, 8, 8)
    farthest = farthest_points(basis.points, 200), farthest_points(moved_basis.points, 200)
    counted = zoomout(basis, moved_basis, C, k_final=60, samples=200)
    named = zoomout(basis, moved_basis, C, k_final=60, samples=farthest)
    assert np.array_equal(named.functional_map, counted.functional_map)
    # Each shape may have its own number of samples; repeated samples do no harm.
    source, target = farthest_points(basis.points, 900), farthest_points(moved_basis.points, 120)
    any_others = zoomout(basis, moved_basis, C, k_final=40, samples=(source[::-1], np.repeat(target, 2)))
    assert (any_others.vertex == moved[1]).mean() > 0.99


def test_fewer_samples_than_eigenfunctions_suffice_for_small_maps(basis, moved_basis, moved) -> None:
    C = functional_map_of(moved[1], basis, moved_basis, 8, 8)
    refined = zoomout(basis, moved_basis, C, k_final=40, samples=60)
    assert (refined.vertex == moved[1]).mean() > 0.99


@pytest.mark.parametrize("samples", [None, 400])
def test_both_ways_recovers_moved_copy_and_its_inverse(basis, moved, moved_basis, samples) -> None:
    C = functional_map_of(moved[1], basis, moved_basis, 6, 6)
    there, back = zoomout_both_ways(basis, moved_basis, C, k_final=50, samples=samples)
    assert np.array_equal(there.vertex, moved[1])
    assert np.array_equal(back.vertex, np.argsort(moved[1]))
    np.testing.assert_allclose(there.functional_map @ back.functional_map, np.eye(50), atol=1e-3)


def test_both_ways_swaps_sizes_for_the_inverse(basis, moved, moved_basis) -> None:
    there, back = zoomout_both_ways(basis, moved_basis, moved[1], sizes=[20, (30, 40)])
    assert there.functional_map.shape == (30, 40)
    assert back.functional_map.shape == (40, 30)


def test_both_ways_halves_the_error_of_mostly_wrong_initial_map(resting, bent, resting_basis) -> None:
    other, truth, random = eigenbasis(bent.surface, 60), true_vertex(resting, bent), np.random.default_rng(0)
    start = np.where(random.random(len(truth)) < 0.8, random.integers(4000, size=len(truth)), truth)
    alone = zoomout(resting_basis, other, start, k_final=60).vertex
    together = zoomout_both_ways(resting_basis, other, start, k_final=60)[0].vertex
    missed = [
        np.linalg.norm(resting.surface.vertices[vertex] - resting.surface.vertices[truth], axis=1).mean()
        for vertex in (alone, together)
    ]
    assert missed[1] < 0.5 * missed[0]


@pytest.fixture(scope="module")
def half(bent: Creature) -> tuple[Surface, np.ndarray]:
    """The left half of the bent creature, and the original numbers of its vertices."""
    inside = (bent.directions[:, 0] > 0.1)[bent.surface.triangles].all(axis=1)
    used, triangles = np.unique(bent.surface.triangles[inside], return_inverse=True)
    return Surface(bent.surface.vertices[used], triangles.reshape(-1, 3)), used


def test_slanted_sizes_refine_a_part_better_than_square_ones(resting, bent, resting_basis, half) -> None:
    part, used = half
    truth = true_vertex(resting, bent)[used]
    other = eigenbasis(part, 100).at_area(part.area / resting.surface.area)
    sizes = slanted_sizes(resting_basis, other, k_final=100)
    r = int((other.eigenvalues < resting_basis.eigenvalues[99]).sum())
    assert 40 < r < 60
    assert sizes[-1] == (r, 100)
    assert all(k_source == round(100 * k_target / r) for k_target, k_source in sizes)
    assert slanted_sizes(other, resting_basis, k_final=100) == [size[::-1] for size in sizes]

    def missed(vertex: np.ndarray) -> float:
        return float(np.linalg.norm(resting.surface.vertices[vertex] - resting.surface.vertices[truth], axis=1).mean())

    slanted = missed(zoomout(resting_basis, other, truth, sizes=sizes).vertex)
    assert slanted < 0.8 * missed(zoomout(resting_basis, other, truth, k_final=100).vertex)
    assert slanted < 0.8 * missed(
        zoomout(resting_basis, eigenbasis(part, 100), truth, sizes=sizes).vertex
    )  # not rescaled


def test_slanted_sizes_of_equal_bases_are_square(basis: SpectralBasis, moved_basis: SpectralBasis) -> None:
    assert slanted_sizes(basis, basis, k_initial=5, k_final=21, step=8) == [(5, 5), (13, 13), (21, 21)]
    assert slanted_sizes(basis, basis, k_initial=50, k_final=30) == [(30, 30)]


def test_basis_at_another_area_equals_that_of_scaled_surface(basis: SpectralBasis) -> None:
    larger = basis.at_area(4.0)
    np.testing.assert_allclose(larger.coefficients(larger.eigenvectors), np.eye(100), atol=1e-5)
    np.testing.assert_allclose(larger.eigenvalues * 4, basis.eigenvalues)
    np.testing.assert_allclose(larger.areas.sum(), 4)
    for area in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="give a positive number"):
            basis.at_area(area)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"k_final": 101}, "100 eigenfunctions of the whole and 100 of the part are too few for k_final = 101"),
        ({"k_final": 0}, "k_final is 0"),
        ({"k_initial": 0}, "k_initial is 0"),
        ({"step": 0.5}, r"step is 0\.5"),
    ],
)
def test_slanted_sizes_refuse_invalid_arguments(basis: SpectralBasis, arguments, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        slanted_sizes(basis, basis, **({"k_final": 100} | arguments))


def test_slanted_sizes_need_part_functions_up_to_highest_frequency(basis: SpectralBasis) -> None:
    few = SpectralBasis(basis.eigenvalues[:30] * 2, basis.eigenvectors[:, :30], basis.areas, basis.points)
    with pytest.raises(ValueError, match="100 eigenfunctions of the whole and 30 of the part are too few"):
        slanted_sizes(basis, few, k_final=100)
    assert slanted_sizes(basis, few, k_final=40)[-1][1] == 40


def test_sampled_basis_fits_like_least_squares(basis: SpectralBasis) -> None:
    samples = farthest_points(basis.points, 150)
    sampled = SampledBasis.of(basis, samples)
    values = np.random.default_rng(1).standard_normal((150, 4))
    for k in (1, 17, 100):
        expected = np.linalg.lstsq(basis.eigenvectors[samples, :k], values, rcond=None)[0]
        np.testing.assert_allclose(sampled.fit(values, k), expected, atol=1e-8)


@pytest.mark.parametrize("k", [4, 12, 30])
def test_nearest_neighbours_are_exact(k: int) -> None:
    random = np.random.default_rng(k)
    points, queries = random.standard_normal((3000, k)), random.standard_normal((500, k))
    squared = ((queries[:, None] - points) ** 2).sum(axis=2)
    found = nearest(queries, points)
    chosen = squared[np.arange(500), found]
    np.testing.assert_allclose(chosen, squared.min(axis=1), rtol=1e-5)
    assert (found == squared.argmin(axis=1)).mean() >= 0.998


def test_nearest_among_returns_the_nearest_candidate() -> None:
    random = np.random.default_rng(0)
    points, queries = random.standard_normal((2000, 40)), random.standard_normal((700, 40))
    candidates = random.integers(2000, size=(700, 12))
    squared = ((queries[:, None] - points[candidates]) ** 2).sum(axis=2)
    expected = candidates[np.arange(700), squared.argmin(axis=1)]
    assert np.array_equal(nearest_among(queries, points, candidates), expected)


@pytest.mark.parametrize(
    ("initial", "arguments", "sentence"),
    [
        (np.eye(4), {"k_final": 101}, "bases of 100"),
        (np.eye(4), {"k_final": 50, "step": 0}, "whole number of 1 or more"),
        (np.eye(60), {"k_final": 50}, "larger than k_final"),
        (np.zeros(7, int), {"k_final": 50}, "for each of 2500"),
        (np.full(2500, 2500), {"k_final": 50}, "vertex numbers from 0 to 2499, but 2500 is not"),
        (np.full(2500, 0.5), {"k_final": 50}, "0.5 is not"),
        (np.full(2500, np.nan), {"k_final": 50}, "nan is not"),
        (np.zeros((2, 2, 2)), {"k_final": 50}, "vector or a matrix"),
        (np.zeros((0, 4)), {"k_final": 50}, "must be a matrix"),
        (3, {"k_final": 50}, "vector or a matrix"),
        (np.full((4, 4), np.nan), {"k_final": 50}, "finite numbers"),
        (np.full((4, 4), "a"), {"k_final": 50}, "finite numbers"),
        (np.eye(4), {"k_final": 0}, "k_final is 0"),
        (np.eye(4), {"k_final": -5}, "k_final is -5"),
        (np.eye(4), {"k_final": 50.0}, r"k_final is 50\.0"),
        (np.eye(4), {"k_final": 50, "samples": 0}, "samples is 0"),
        (np.eye(4), {"k_final": 50, "samples": 5.5}, r"samples is 5\.5"),
        (np.eye(4), {"k_final": 50, "samples": "all"}, "samples is 'all'"),
        (
            np.eye(4),
            {"k_final": 50, "samples": (range(49), range(60))},
            "The 49 samples of the source cannot distinguish",
        ),
        (
            np.eye(4),
            {"k_final": 50, "samples": (range(60), range(49))},
            "The 49 samples of the target cannot distinguish",
        ),
        (np.eye(4), {"k_final": 50, "samples": (range(60), [7] * 60)}, "cannot distinguish its 50 functions"),
        (np.eye(4), {"k_final": 50, "samples": (range(60), [2500] * 60)}, "Samples of the target .* 2500 is not"),
        (np.eye(4), {"k_final": 50, "samples": ([-1] * 60, range(60))}, "Samples of the source .* -1 is not"),
        (np.eye(4), {"k_final": 50, "samples": ([], [])}, "The 0 samples of the source cannot distinguish"),
        (np.eye(4), {"sizes": []}, r"sizes is \[\]: give a list"),
        (np.eye(4), {"sizes": 50}, "sizes is 50: give a list"),
        (np.eye(4), {"sizes": [(1, 2, 3)]}, "give a list"),
        (np.eye(4), {"sizes": [20, [(1, 2), 3]]}, "give a list"),
        (np.eye(4), {"sizes": [20, "large"]}, "a whole number of 1 or more"),
        (np.eye(4), {"sizes": [(20, 0)]}, "a whole number of 1 or more"),
        (np.eye(4), {"sizes": [20.5]}, "a whole number of 1 or more"),
        (np.eye(4), {"sizes": [20, (101, 20)]}, "101 target and 20 source functions is larger than the bases"),
        (np.eye(101), {"sizes": [20]}, "larger than the bases"),
    ],
)
def test_invalid_arguments_are_refused(basis, initial, arguments, sentence) -> None:
    for refine in (zoomout, zoomout_both_ways):
        with pytest.raises(ValueError, match=sentence) as refusal:
            refine(basis, basis, initial, **arguments)
        assert "\n" not in str(refusal.value)


def test_vertex_map_of_integral_floats_is_accepted(basis: SpectralBasis) -> None:
    identity = np.arange(2500.0)
    assert np.array_equal(zoomout(basis, basis, identity, k_final=40).vertex, np.arange(2500))


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(("dimension", "noise"), [(20, 0.01), (60, 0.5), (60, 50.0)])
def test_clustered_search_never_prunes_the_nearest_point(dimension: int, noise: float) -> None:
    random = np.random.default_rng(0)
    # A curved surface in many dimensions, like an embedding; noise makes it ever less like one.
    place, mixing = random.random((12_000, 2)), random.standard_normal((2, dimension)) * 6
    points = np.sin(place @ mixing)
    queries = np.sin((place + 0.001) @ mixing) + noise * random.standard_normal(points.shape)
    assert len(queries) * len(points) > MIN_CLUSTERED_PAIRS
    found = nearest(queries, points)
    exact = np.concatenate([
        np.argmin((points**2).sum(axis=1) - 2 * few @ points.T, axis=1) for few in np.array_split(queries, 40)
    ])  # fmt: skip
    distance, least = (np.linalg.norm(queries - points[row], axis=1) for row in (found, exact))
    assert (found == exact).mean() > 0.999
    np.testing.assert_allclose(distance, least, atol=1e-4)


def test_nearest_neighbours_are_found_among_duplicates() -> None:
    points = np.repeat(np.eye(20), 600, axis=0)
    found = nearest(points + 0.01, points)
    np.testing.assert_array_equal(points[found], points)


@pytest.mark.parametrize(
    ("shape", "source", "target"), [((3,), 3, 3), ((3, 4), 3, 3), ((4, 3), 3, 3), ((0, 3), 3, 3), ((2, 2, 2), 3, 3)]
)
def test_errors_of_maps_need_an_eigenvalue_for_each_row_and_column(
    shape: tuple[int, ...], source: int, target: int
) -> None:
    for error in (commutativity_error, frequency_error):
        with pytest.raises(ValueError, match=r"does not fit eigenvalues of shapes \(3,\) of the source"):
            error(np.ones(shape), np.arange(source), np.arange(target))
        assert error(np.eye(2), np.arange(source), np.arange(target)) == 0
