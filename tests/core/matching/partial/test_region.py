# SPDX-License-Identifier: GPL-3.0-or-later
"""Small parts are searched for in regions of the whole, each analysed at its own size."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from creatures import Creature, directions, true_vertex
from pieces import analyse_piece, piece_of
from scipy.special import expit

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.curvature import CURVATURE
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale
from zoomout_core.matching.partial.part_candidates import PART_CANDIDATES, PartCandidate, _Found, images_apart
from zoomout_core.matching.partial.part_match import (
    fit_part,
    in_one_unit,
    match_part,
    part_of,
    sizes_differ,
)
from zoomout_core.matching.partial.part_registration import RegisteredPart
from zoomout_core.matching.partial.region import REGION, Region, find_regions, is_small
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import SMALL_PART_CERTAINTY, certainty_of_part
from zoomout_core.matching.refinement.dense_map import dense_map
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import outward_hull
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("few_candidates")

# Directions and lengths of the fingers of the left hand; the body has a hand on each side.
FINGERS, LENGTHS = (
    np.array([[1, 0, 0.3], [1, 0.3, 0.1], [1, 0.3, -0.25], [1, -0.35, -0.1]]),
    np.array([1.2, 0.7, 0.4, 0.9]),
)
# Cosine of the angle from the x axis at which a hand is cut off.
WRIST = 0.87


def two_handed(count: int, seed: int) -> Creature:
    """A ball with fingers on its left, their mirror images on its right, and a head."""
    where = directions(count, seed)
    # More vertices at the hands.
    where[:, 0] *= 1.7
    where /= np.linalg.norm(where, axis=1, keepdims=True)
    left = FINGERS / np.linalg.norm(FINGERS, axis=1, keepdims=True)
    fingers = np.concatenate([left, left * [-1, 1, 1]])
    radius = 1 + np.exp(90 * (where @ fingers.T - 1)) @ np.tile(LENGTHS, 2) + np.exp(4 * (where[:, 2] - 1))
    triangles = outward_hull(where)
    return Creature(Surface(where * radius[:, None] * [1, 1.6, 2.0], triangles), where)


def hand_and_body(count: int, of_body: int) -> tuple[Creature, Creature, Pair]:
    """The left hand of one mesh of the body, another mesh of the body, and the pair in one unit."""
    other, body = two_handed(count, 1), two_handed(of_body, 0)
    hand = piece_of(other, other.directions[:, 0] > WRIST)
    return hand, body, in_one_unit(Pair(body.surface, hand.surface, analyse_piece(body), analyse_piece(hand), 60, 20))


@pytest.fixture(scope="module")
def made() -> tuple[Creature, Creature, Pair]:
    return hand_and_body(3000, 2500)


@pytest.fixture(scope="module")
def regions(made: tuple[Creature, Creature, Pair]) -> list[Region]:
    return find_regions(*part_of(made[2]))


@pytest.fixture(scope="module")
def found(made: tuple[Creature, Creature, Pair]) -> list[Candidate]:
    with retune(REGION, small=0.15):
        return match_part(made[2])


def errors_of(images: SurfaceMap, made: tuple[Creature, Creature, Pair]) -> np.ndarray:
    """(n,) distances of images of the hand's vertices from their true places, at unit area of the body."""
    hand, body, pair = made
    points = pair.source_shape.mesh.vertices
    return np.asarray(np.linalg.norm(images.interpolate(points) - points[true_vertex(body, hand)], axis=1))


def placement_of(one: Candidate) -> SurfaceMap:
    assert one.part_match is not None
    return one.part_match.region.to_whole(one.part_match.registered).closest


def test_hand_is_found_on_the_right_side_with_certainty(
    made: tuple[Creature, Creature, Pair], found: list[Candidate]
) -> None:
    assert np.median(errors_of(placement_of(found[0]), made)) < 0.02
    assert found[0].certainty > 0.9
    assert max(other.certainty for other in found[1:]) < 0.1


def test_places_of_a_hand_are_not_ranked_by_curvature(found: list[Candidate]) -> None:
    """Hands and feet have a certainty of their own, which was set without curvature."""
    assert not any(CURVATURE in one.scores for one in found)


@pytest.mark.slow
def test_the_search_without_regions_finds_no_hand(made: tuple[Creature, Creature, Pair]) -> None:
    with retune(REGION, small=0.0), retune(PART_CANDIDATES, regions=1):
        usual = match_part(made[2])
    assert min(np.median(errors_of(placement_of(one), made)) for one in usual) > 0.1


def test_body_has_partners_only_on_the_hand(made: tuple[Creature, Creature, Pair], found: list[Candidate]) -> None:
    fit = fit_part(made[2], found[0])
    assert np.median(errors_of(fit.fit.surface_map, made)) < 0.02
    assert fit.partners.target.mean() > 0.95
    on_hand = made[1].directions[:, 0] > WRIST
    both, either = fit.partners.source & on_hand, fit.partners.source | on_hand
    assert both.sum() > 0.8 * either.sum()
    # Positions are in the body's frame and unit.
    true = made[2].source_shape.mesh.vertices[true_vertex(made[1], made[0])]
    assert np.median(np.linalg.norm(fit.fit.positions - true, axis=1)) < 0.02
    assert fit.fit.rotations.shape == (len(true), 3, 3)


@pytest.mark.slow
def test_body_as_target_is_confident_only_on_its_hand(
    made: tuple[Creature, Creature, Pair], found: list[Candidate]
) -> None:
    pair = made[2]
    swapped = replace(pair, source=pair.target, target=pair.source)
    swapped = replace(swapped, source_shape=pair.target_shape, target_shape=pair.source_shape)
    with retune(REGION, small=0.15):
        one = replace(found[0], functional_map=np.eye(60, 20))
        refined = dense_map(swapped, one)
    on_hand = made[1].directions[:, 0] > WRIST
    assert np.median(refined.confidence[on_hand]) > 0.5
    assert np.median(refined.confidence[~on_hand]) == 0
    with retune(REGION, small=0.0):
        by_whole = dense_map(swapped, one).confidence
    assert np.median(by_whole[on_hand]) < 0.3


@pytest.mark.slow
def test_regions_are_few_distinct_and_sized_to_the_part(
    made: tuple[Creature, Creature, Pair], regions: list[Region]
) -> None:
    hand, body, pair = made
    assert 2 <= len(regions) <= REGION.max_count
    on_hand = true_vertex(body, hand)
    assert max(region.contains[on_hand].mean() for region in regions) == 1
    for region in regions:
        areas = [each.shape.basis.areas.sum() for each in (region.part, region.whole)]
        assert areas[0] == pytest.approx(REGION.part_area)
        assert areas[0] < areas[1] < 0.9 / region.unit**2
        assert region.unit**2 * areas[0] == pytest.approx(part_of(pair)[0].basis.areas.sum())
        assert not region.is_everywhere
    for retuning in ({"max_count": 1}, {"apart": 10.0}):
        with retune(REGION, **retuning):
            assert len(find_regions(*part_of(pair))) == 1
    with retune(REGION, max_count=1, radius=2.5):
        (larger,) = find_regions(*part_of(pair))
    assert larger.contains.sum() > 1.5 * regions[0].contains.sum()
    with retune(REGION, max_count=1, vertices=300):
        (coarser,) = find_regions(*part_of(pair))
    assert len(coarser.whole.shape.mesh.vertices) < 400 < len(regions[0].whole.shape.mesh.vertices)


def register_onto(region: Region) -> RegisteredPart:
    """A registered part whose vertices are placed on successive triangles of a region."""
    mesh, n = region.whole.shape.mesh, len(region.part.shape.mesh.vertices)
    triangle = np.arange(n) % len(mesh.triangles)
    closest = SurfaceMap(triangle, np.tile([1.0, 0, 0], (n, 1)), mesh.triangles)
    corner, turn, flags = mesh.triangles[triangle, 0], np.tile(np.eye(3), (n, 1, 1)), np.ones(n, dtype=bool)
    ones = np.ones(n)
    return RegisteredPart(
        mesh.vertices[corner], mesh.vertex_normals[corner], turn, closest, 0.5 * ones, ones, flags, ~flags, 0.1
    )


@pytest.mark.slow
def test_registration_onto_a_region_carries_over_to_the_whole(
    made: tuple[Creature, Creature, Pair], regions: list[Region]
) -> None:
    region, whole = regions[0], made[2].source_shape
    bent = register_onto(region)
    carried = region.to_whole(bent)
    assert region.vertex is not None
    np.testing.assert_allclose(carried.positions, whole.mesh.vertices[region.vertex[bent.closest.vertex]], atol=1e-12)
    np.testing.assert_allclose(carried.closest.interpolate(whole.mesh.vertices), carried.positions, atol=1e-6)
    np.testing.assert_allclose(carried.residual, 0.5 * region.unit)
    places = np.arange(20)
    samples = region.vertex[region.whole.shape.search.samples[:20]]
    np.testing.assert_allclose(region.in_space(places), whole.mesh.vertices[samples], atol=1e-12)


@pytest.mark.slow
def test_maps_into_two_regions_are_compared_in_space(regions: list[Region]) -> None:
    region, places = regions[0], np.arange(50)
    assert region.vertex is not None
    same = replace(region)
    elsewhere = replace(region, vertex=region.vertex)
    elsewhere.__dict__["whole"] = IncompleteShape(moved_by(region.whole.shape, np.array([0.3, 0, 0])))
    here = _Found(0.0, region, places)
    assert images_apart(here, _Found(0.0, same, places)) == pytest.approx(0, abs=1e-12)
    assert images_apart(here, _Found(0.0, elsewhere, places)) == pytest.approx(0.3)


def moved_by(shape: ShapeAnalysis, shift: np.ndarray) -> ShapeAnalysis:
    """Move a shape in its surface's frame, by a shift at unit area."""
    full = shape.proxy.full
    full = replace(full, origin=full.origin + full.scale * shift)
    return replace(shape, proxy=replace(shape.proxy, full=full))


@pytest.mark.parametrize(("ratio", "small"), [(0.5, False), (0.3, False), (0.25, True), (0.1, True), (0.08, False)])
def test_hands_are_small_parts_unless_units_differ(
    made: tuple[Creature, Creature, Pair], ratio: float, small: bool
) -> None:
    pair = made[2]
    factor = ratio * pair.source_shape.proxy.full.scale / pair.target_shape.proxy.full.scale
    target = at_scale(pair.target_shape, 1 / factor)
    full = replace(target.proxy.full, scale=ratio * pair.source_shape.proxy.full.scale)
    of_size = replace(pair, target_shape=replace(target, proxy=replace(target.proxy, full=full)))
    assert sizes_differ(of_size) == small
    for share in (0.5 * REGION.small, 2 * REGION.small):
        part, whole = (
            cast(ShapeAnalysis, SimpleNamespace(basis=SimpleNamespace(areas=np.full(4, area / 4))))
            for area in (share, 1.0)
        )
        assert is_small(part, whole) == (share < REGION.small)


def test_certainty_of_a_small_part_falls_with_close_rivals() -> None:
    region: Any = SimpleNamespace(is_everywhere=False, whole=SimpleNamespace(between=1 - np.eye(3)))

    def candidate(place: int, fit: float) -> Candidate:
        nothing = cast(Any, None)
        scores = {"fit": fit, "total": fit, "extent": 0.4}
        at = PartCandidate(region, np.full(5, place), nothing, scores)
        return Candidate("", False, False, nothing, nothing, nothing, None, None, 0.0, scores, at)

    one = candidate(0, -5.5)
    alone = certainty_of_part(one, [one])
    assert alone == pytest.approx(expit(SMALL_PART_CERTAINTY.misfit_rate * 5.5 - SMALL_PART_CERTAINTY.misfit))
    behind = certainty_of_part(one, [one, candidate(1, -5.3)])
    assert behind == pytest.approx(alone / (1 + np.exp(-0.2 * SMALL_PART_CERTAINTY.rivalry)))
    assert behind < 0.8 < 0.9 < alone
