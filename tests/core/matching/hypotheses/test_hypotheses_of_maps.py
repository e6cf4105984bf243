# SPDX-License-Identifier: GPL-3.0-or-later
"""The automatic hypotheses include the right map for every kind of shape."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest
from creatures import Creature
from scipy.spatial import cKDTree
from shapes import CENTAUR, HAND, HEAD, ONE_ARMED_CENTAUR, SPIDER, STONE, TABLE, Figure, Shaped, shape, sheet, truth

import zoomout_core as zo
from zoomout_core.maps.upsample import nearest_samples, upsample
from zoomout_core.matching.hypotheses.descriptors import DESCRIPTORS, descriptor_hypotheses
from zoomout_core.matching.hypotheses.extremities import (
    EXTREMITIES,
    cheapest_pairings,
    extremities,
    extremity_hypotheses,
    pairings,
)
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis, alike
from zoomout_core.matching.hypotheses.signs import sign_hypotheses
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.landmark_features import landmark_features
from zoomout_core.mesh.surface import Surface


def analyse_surface(surface: Surface) -> ShapeAnalysis:
    return analyse(surface.working.part(0)[0], 100, 500, 0)


def error_of(
    hypothesis: Hypothesis, source: ShapeAnalysis, target: ShapeAnalysis, places: tuple[np.ndarray, np.ndarray]
) -> float:
    """Mean distance at rest between samples and their images by the refined hypothesis, over sqrt(area)."""
    samples = source.search.samples, target.search.samples
    anchors = hypothesis.anchors and hypothesis.anchors.at(*samples)
    refined, _ = upsample(source.search, target.search, hypothesis.functional_map, 30, 2, anchors)
    images = samples[0][nearest_samples(source.search, target.search, refined, anchors)]
    return float(np.linalg.norm(places[0][images] - places[1][samples[1]], axis=1).mean() / source.mesh.scale)


@pytest.fixture(scope="module")
def shapes(resting: Creature, bent: Creature) -> tuple[ShapeAnalysis, ShapeAnalysis]:
    return analyse_surface(resting.surface), analyse_surface(bent.surface)


@pytest.fixture(scope="module")
def stones() -> tuple[Shaped, Shaped]:
    return shape(STONE, 1500, seed=0), shape(STONE, 1200, seed=1)


# --- extremities --------------------------------------------------------------------------------------------


def test_extremities_are_the_tips_of_the_limbs(shapes, resting, bent) -> None:
    limbs = np.array([[1, 0.1, 0.35], [-1, 0.1, 0.35], [0.45, 0, -1], [-0.45, 0, -1], [0, 1, -0.25]])
    limbs /= np.linalg.norm(limbs, axis=1, keepdims=True)
    for prepared_shape, creature in zip(shapes, (resting, bent), strict=True):
        tips = creature.directions[extremities(prepared_shape).vertices]
        assert ((tips @ limbs.T).max(axis=0) > 0.97).all()
        assert len(tips) <= 6


def test_the_true_pairing_of_extremities_is_among_the_first(shapes, resting, bent) -> None:
    source, target = shapes
    tips_source, tips_target = extremities(source), extremities(target)
    found = pairings(tips_target, tips_source)
    agreement = [
        np.einsum(
            "ij,ij->i",
            bent.directions[tips_target.vertices[of_target]],
            resting.directions[tips_source.vertices[of_source]],
        ).min()
        for of_target, of_source in found
    ]
    assert max(agreement[:4]) > 0.97
    assert 0 < len(extremity_hypotheses(source, target)) <= EXTREMITIES.kept


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(("figure", "count"), [(HAND, 6), (CENTAUR, 9), (SPIDER, 11)])
def test_every_limb_of_a_many_limbed_creature_is_an_extremity(figure: Figure, count: int) -> None:
    assert len(extremities(analyse_surface(shape(figure, 2000, seed=0, bend=0.5).surface)).vertices) == count


@pytest.mark.slow
@pytest.mark.parametrize(
    ("of_source", "of_target"), [(CENTAUR, CENTAUR), (CENTAUR, ONE_ARMED_CENTAUR), (ONE_ARMED_CENTAUR, CENTAUR)]
)
def test_creatures_of_many_limbs_are_paired_even_if_one_is_missing(of_source: Figure, of_target: Figure) -> None:
    source, target = shape(of_source, 2000, seed=0), shape(of_target, 1500, seed=1, bend=0.8)
    source_shape, target_shape = analyse_surface(source.surface), analyse_surface(target.surface)
    hypotheses = extremity_hypotheses(source_shape, target_shape)
    known = cKDTree(source.places).query(target.places)[0] < 0.15  # excludes the missing arm
    samples = target_shape.search.samples
    images = source_shape.search.samples
    errors = []
    for hypothesis in hypotheses:
        assert hypothesis.anchors is not None
        anchors = hypothesis.anchors.at(images, samples)
        C, _ = upsample(source_shape.search, target_shape.search, hypothesis.functional_map, 30, 2, anchors)
        image = images[nearest_samples(source_shape.search, target_shape.search, C, anchors)]
        off = np.linalg.norm(source.places[image] - target.places[samples], axis=1) / source_shape.mesh.scale
        errors.append(off[known[samples]].mean())
    assert min(errors) < 0.05


@pytest.mark.parametrize(("a", "b", "size"), [(7, 7, 7), (7, 7, 6), (5, 7, 5), (7, 5, 4), (6, 7, 4), (3, 3, 2)])
@pytest.mark.parametrize("noise", [0.1, 1.5])
def test_pairings_are_the_globally_cheapest(a: int, b: int, size: int, noise: float) -> None:
    random = np.random.default_rng(a + 10 * b + 100 * size)
    points = random.standard_normal((7, 3))
    moved = points[random.permutation(7)] + noise * random.standard_normal((7, 3))
    between = [
        np.linalg.norm(cloud[:, None] - cloud[None], axis=2)[:count, :count]
        for cloud, count in ((points, a), (moved, b))
    ]
    single = np.abs(between[0].mean(axis=1)[:, None] - between[1].mean(axis=1))
    mutual = np.abs(between[0][:, None, :, None] - between[1][None, :, None, :])

    def cost(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        i, j = np.triu_indices(size, k=1)
        return mutual[left[:, i], right[:, i], left[:, j], right[:, j]].mean(axis=1) + single[left, right].mean(axis=1)

    orders = np.array(list(permutations(range(b), size)))
    subsets = np.array(list(combinations(range(a), size)))
    every = np.sort(cost(np.repeat(subsets, len(orders), axis=0), np.tile(orders, (len(subsets), 1))))
    found = cost(*cheapest_pairings(single, mutual, size))
    most = min(20, len(every))
    np.testing.assert_allclose(found[:most], every[:most])
    assert (np.diff(found) >= -1e-12).all()


def test_turns_change_sign_if_places_are_swapped(shapes) -> None:
    places = landmark_features(shapes[0], np.array([0, 100, 200]))
    one, other = places.features(np.array([0, 1, 2])), places.features(np.array([1, 0, 2]))
    np.testing.assert_allclose(one[:, [0, 1, 2]], other[:, [1, 0, 2]])
    np.testing.assert_allclose(one[:, 3], -other[:, 3])
    np.testing.assert_allclose(one[:, [4, 5]], other[:, [5, 4]])


# --- descriptors, rotations----------------------------------------------------------------------------------


def test_descriptors_find_the_map_of_a_shape_without_limbs(stones: tuple[Shaped, Shaped]) -> None:
    source, target = (analyse_surface(stone.surface) for stone in stones)
    places = stones[0].places, stones[1].places
    errors = {
        hypothesis.origin: error_of(hypothesis, source, target, places)
        for hypothesis in descriptor_hypotheses(source, target)
    }
    assert min(error for origin, error in errors.items() if "+" in origin) < 0.05


@pytest.mark.slow
def test_descriptors_find_a_mirror_image_with_the_other_sign(stones: tuple[Shaped, Shaped]) -> None:
    mirror = Surface(stones[1].surface.vertices * [-1, 1, 1], stones[1].surface.triangles[:, ::-1])
    source, target = analyse_surface(stones[0].surface), analyse_surface(mirror)
    places = stones[0].places, stones[1].places
    errors = {
        hypothesis.origin: error_of(hypothesis, source, target, places)
        for hypothesis in descriptor_hypotheses(source, target)
    }
    assert min(error for origin, error in errors.items() if "-" in origin) < 0.05


def test_no_two_fits_of_descriptors_are_alike(shapes) -> None:
    source, target = shapes
    places = [
        source.coordinates[nearest_samples(source.search, target.search, hypothesis.functional_map)]
        for hypothesis in descriptor_hypotheses(source, target)
    ]
    assert len(places) > 1
    assert not np.tril(alike(places, DESCRIPTORS.same_fit), -1).any()


# --- incomplete shapes --------------------------------------------------------------------------------------


def test_a_plane_has_no_curvature_and_raises_no_warning() -> None:
    flat = sheet(600)
    single = Surface(flat.surface.vertices.astype(np.float32), flat.surface.triangles)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for surface in (flat.surface, single):
            assert not analyse_surface(surface).curvature.any()
    bent = flat.places.copy()
    bent[:, 2] = 0.05 * bent[:, 0] ** 2
    assert np.abs(analyse_surface(Surface(bent, flat.surface.triangles)).curvature).max() > 0.1


def test_featureless_shapes_give_finite_hypotheses() -> None:
    golden = (1 + 5**0.5) / 2
    corners = [(0, x, y * golden) for x in (-1, 1) for y in (-1, 1)]
    points = np.array([np.roll(corner, turn) for corner in corners for turn in range(3)])
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    faces = [t for t in combinations(range(12), 3) if max(distance[i, j] for i, j in combinations(t, 2)) < 2.1]
    icosahedron = Surface(points, faces)
    table = shape(TABLE, 800, seed=0).surface
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for surface in (icosahedron, table):
            other = analyse_surface(surface)
            for generate in (extremity_hypotheses, sign_hypotheses, descriptor_hypotheses):
                assert all(np.isfinite(hypothesis.functional_map).all() for hypothesis in generate(other, other))
            assert np.isfinite(other.curvature).all()
            assert np.isfinite(other.pseudo_scalars).all()


# --- inside and outside -------------------------------------------------------------------------------------


@pytest.mark.parametrize("inwards", [False, True])
@pytest.mark.slow(but=1)
def test_open_shell_is_not_mirrored_with_either_winding(inwards: bool) -> None:
    shell = replace(STONE, kept=lambda places: places @ [0.3, -0.2, 1] > -0.1)
    source, target = shape(shell, 2500, seed=0), shape(shell, 2000, seed=1)
    triangles = target.surface.triangles[:, ::-1] if inwards else target.surface.triangles
    result = zo.match(source.surface, Surface(target.surface.vertices, triangles))
    used = np.unique(triangles)
    error = zo.geodesic_error(result.surface_map, source.surface, used, truth(source, target)[used])
    assert error.mean() < 0.03
    assert not result.candidates[0].reverses_orientation


def test_sides_are_known_only_for_shapes_that_enclose_space() -> None:
    thin = shape(STONE, 800, seed=0).surface
    coin = Surface(thin.vertices * [1, 1, 1e-3], thin.triangles[:, ::-1])
    assert coin.working.flipped.all()
    assert coin.working.sides_are_known
    assert shape(HEAD, 800, seed=0).surface.working.part(0)[0].sides_are_known
    flat = sheet(600)
    assert not flat.surface.working.sides_are_known
    curled = flat.places.copy()
    curled[:, 0], curled[:, 2] = np.sin(0.6 * curled[:, 0]), np.cos(0.6 * curled[:, 0])
    assert not Surface(curled, flat.surface.triangles).working.sides_are_known


def test_turns_change_sign_if_seen_from_inside(shapes) -> None:
    places, order = landmark_features(shapes[0], np.array([0, 100, 200])), np.arange(3)
    outside, inside, neither = (places.features(order, side) for side in (1, -1, 0))
    np.testing.assert_allclose(inside, outside * [1, 1, 1, -1, -1, -1])
    np.testing.assert_allclose(neither, outside * [1, 1, 1, 0, 0, 0])


def test_cloth_is_paired_by_its_corners_on_either_side() -> None:
    source, target = sheet(600, seed=0), sheet(500, seed=1)
    places = source.places, target.places
    for triangles in (target.surface.triangles, target.surface.triangles[:, ::-1]):
        shapes = analyse_surface(source.surface), analyse_surface(Surface(target.surface.vertices, triangles))
        assert min(error_of(hypothesis, *shapes, places) for hypothesis in extremity_hypotheses(*shapes)) < 0.05
