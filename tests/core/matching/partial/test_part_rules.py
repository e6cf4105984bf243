# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of partial matching: terms of the cost of a map, partners of places, and rival maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from pieces import PartAndWhole
from reports import reports_of

from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial import part_candidates as candidates_module
from zoomout_core.matching.partial import part_match
from zoomout_core.matching.partial.curvature import (
    CURVATURE,
    CURVATURE_FLOOR,
    PART_CURVATURE,
    curvature_agreement,
    curvature_score,
)
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale, unlikeness
from zoomout_core.matching.partial.landmark_maps import LANDMARK_MAPS, place_few
from zoomout_core.matching.partial.landmark_search import SEARCH, _cost_of_pair, distinct, landmarks_of
from zoomout_core.matching.partial.part_candidates import (
    PART_CANDIDATES,
    PartCandidate,
    _Found,
    _map_cost,
    _register,
    _scores,
    _search,
    part_candidates,
    rough_candidates,
)
from zoomout_core.matching.partial.part_match import (
    PART_MATCH,
    _candidate,
    _on_part,
    fit_part,
    match_part,
    places_of,
    units_differ,
)
from zoomout_core.matching.partial.part_registration import PART_REGISTRATION, RegisteredPart, register_part
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import PART_CERTAINTY, certainty_of_part
from zoomout_core.matching.ranking.scores import EVIDENCE_WEIGHTS, UPRIGHT
from zoomout_core.matching.refinement.dense_map import dense_map
from zoomout_core.runtime.progress import advance
from zoomout_core.tuning import retune

# --- maps from landmarks ------------------------------------------------------------------------------------


def test_a_third_of_the_landmarks_may_be_wrong(lower: PartAndWhole) -> None:
    whole = lower.whole
    chosen, nothing = landmarks_of(whole, 9), np.zeros_like(whole.between)
    placed = chosen.copy()
    placed[-3:] = np.argmax(whole.between[chosen[-3:]], axis=1)
    right = []
    for max_cost in (LANDMARK_MAPS.max_cost, 100.0):
        with retune(LANDMARK_MAPS, rounds=1, landmarks=len(nothing), max_cost=max_cost):
            right.append(np.mean(place_few(chosen, placed, nothing, whole, whole) == np.arange(len(nothing))))
    assert right[0] > 0.98
    assert right[1] < 0.8


def on_a_line(*places: float, cut: float = np.inf) -> Any:
    """Stand-in for a shape of places on a line; distances longer than `cut` count as affected by a cut."""
    between = np.abs(np.subtract.outer(places, places))
    return SimpleNamespace(between=between, unaffected=between <= cut)


def test_pair_cost_is_capped_and_discounted_near_cuts() -> None:
    whole, part, cut = on_a_line(0, 0.5, 1.0, 3.0), on_a_line(0, 1.0), on_a_line(0, 1.0, cut=0.1)
    tolerance = SEARCH.tolerance + SEARCH.relative_tolerance
    off = [0.1, -0.1]  # deviations from a distance of one
    at = on_a_line(0, *(1 + np.array(off)))
    costs = _cost_of_pair(0, 1, part, at, 3)[0, 1:]
    np.testing.assert_allclose(costs, 0.1 / tolerance, rtol=1e-5)
    doubted = _cost_of_pair(0, 1, cut, at, 3)[0, 1:]
    # A cut lengthens paths on the part, so shorter distances on the whole are discounted.
    np.testing.assert_allclose(doubted, [0.1 / tolerance, SEARCH.doubt * 0.1 / tolerance], rtol=1e-5)
    short = on_a_line(0, *(1 + np.array(off)), cut=0.1)
    doubted = _cost_of_pair(0, 1, part, short, 3)[0, 1:]
    np.testing.assert_allclose(doubted, [SEARCH.doubt * 0.1 / tolerance, 0.1 / tolerance], rtol=1e-5)
    np.testing.assert_array_equal(_cost_of_pair(0, 1, part, whole, 4)[0], [1, 1, 0, 1])


def test_distinct_assignments_are_apart_and_limited_in_number() -> None:
    whole = on_a_line(*np.arange(200) * 0.08)
    # The second differs from the first by 0.08, the third by 0.16 on average.
    placed = np.array([[0, 50], [0, 52], [1, 53], [2, 52], [100, 150], [100, 151]])
    assert distinct(placed, whole) == [0, 2, 4]
    many = np.column_stack([2 * np.arange(80)] * 2)
    assert distinct(many, whole) == list(range(SEARCH.kept))


# --- cost of a map -----------------------------------------------------------------------------------------


def region_of(part: IncompleteShape, whole: IncompleteShape, unlike: Floats) -> Region:
    """The whole as a region, with given unlikeness to the part's places."""
    region = Region.everywhere(part, whole)
    region.__dict__["unlike"] = unlike
    return region


def at_mirror_images(pair: PartAndWhole) -> Integers:
    """(d,) place of the whole at the mirror image of each part place's true image."""
    directions = pair.made_whole.directions[pair.whole.shape.search.samples[: len(pair.whole.between)]]
    true = directions[pair.true_places()] * [-1, 1, 1]
    return np.asarray(np.argmax(true @ directions.T, axis=1))


@pytest.mark.parametrize("term", ["facing", "bend", "distance", "unlikeness"])
def test_each_term_favours_the_true_map_over_its_mirror_image(lower: PartAndWhole, term: str) -> None:
    lead, weight = [], getattr(PART_CANDIDATES, term)
    for tried in (0.0, weight):
        with retune(PART_CANDIDATES, **{term: tried}):
            right, wrong = (_map_cost(m, lower.everywhere) for m in (lower.true_places(), at_mirror_images(lower)))
        lead.append(wrong - right)
    assert lead[1] > lead[0] + 0.1 * weight


def test_bend_is_measured_in_small_surroundings(lower: PartAndWhole) -> None:
    none = dict.fromkeys(("facing", "distance", "unlikeness", "within"), 0.0)
    costs = []
    for width in (PART_CANDIDATES.surroundings, 1.2):
        with retune(PART_CANDIDATES, surroundings=width, **none | {"bend": 1.0}):
            costs.append(_map_cost(lower.true_places(), lower.everywhere))
    # Limbs bend, so a single rotation leaves at least 1.2 times the error for the true map.
    assert costs[0] < costs[1] - np.log(1.2)


@pytest.mark.parametrize(
    ("term", "floor"), [("facing", 0.01), ("bend", 0.003), ("distance", 0.003), ("unlikeness", 0.01)]
)
def test_term_of_a_perfect_map_is_the_log_of_its_floor(lower: PartAndWhole, term: str, floor: float) -> None:
    every = np.arange(len(lower.whole.between))
    none = dict.fromkeys(("facing", "bend", "distance", "unlikeness", "within"), 0.0)
    with retune(PART_CANDIDATES, **none | {term: 1.0}):
        cost = _map_cost(every, region_of(lower.whole, lower.whole, 1 - np.eye(len(every))))
    assert cost == pytest.approx(np.log(floor), abs=1e-3)


def test_cuts_excuse_only_longer_distances_on_the_part(lower: PartAndWhole) -> None:
    part, unlike = lower.part, unlikeness(lower.part, lower.whole)

    def gained(match: Integers, of: IncompleteShape, factor: float) -> float:
        """Improvement of a cost by doubt, with lengths on the whole scaled by a factor."""
        whole, costs = IncompleteShape(at_scale(lower.whole.shape, factor)), []
        for doubt in (SEARCH.doubt, 1.0):
            with retune(SEARCH, doubt=doubt):
                known = unlike if of is part else np.zeros_like(whole.between)
                costs.append(_map_cost(match, region_of(of, whole, known)))
        return costs[1] - costs[0]

    longer = gained(lower.true_places(), part, 0.7)
    assert longer > 0.02
    assert abs(gained(lower.true_places(), part, 1.4)) < 0.1 * longer
    # Doubt has no effect without a cut nearby.
    every = np.arange(len(lower.whole.between))
    assert lower.whole.unaffected.all()
    assert gained(every, lower.whole, 0.7) == 0


def candidates_of(monkeypatch: pytest.MonkeyPatch, pair: PartAndWhole, maps: list[Integers]) -> list[Integers]:
    """Maps that remain for bending when the given maps are found, in ascending order of cost."""

    def registered(one: _Found | PartCandidate) -> PartCandidate:
        nothing: Any = None
        if isinstance(one, PartCandidate):
            return one
        return PartCandidate(one.region, one.places, nothing, {"cost": one.cost, "fit": one.cost})

    def cost_of(places: Integers, _: Region) -> float:
        return float(next(i for i, each in enumerate(maps) if each is places))

    monkeypatch.setattr(candidates_module, "_search", lambda *_: maps[::-1])
    monkeypatch.setattr(candidates_module, "_map_cost", cost_of)
    monkeypatch.setattr(candidates_module, "_register", registered)
    with retune(PART_CANDIDATES, regions=0, registered=3, compared=3):
        result, reports = reports_of(lambda: part_candidates([pair.everywhere]))
    fractions = [0.0, *(report.fraction for report in reports), 1.0]
    assert fractions == sorted(fractions)
    assert len(set(fractions)) > 3
    return [found.places for found in result]


def test_cheapest_of_similar_maps_is_kept(lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch) -> None:
    right, other = lower.true_places(), at_mirror_images(lower)
    nearly, off = right.copy(), right.copy()
    some = np.random.default_rng(0).permutation(len(right))
    nearly[some[: len(some) // 25]] = other[some[: len(some) // 25]]
    off[some[: len(some) // 3]] = other[some[: len(some) // 3]]
    small, large = (lower.whole.between[each, right].mean() for each in (nearly, off))
    assert 0 < small < 0.05 < large
    found = candidates_of(monkeypatch, lower, [nearly, right, off, other, np.roll(right, 50)])
    assert [one is expected for one, expected in zip(found, (nearly, off, other), strict=True)] == [True] * 3


def test_assignments_are_extended_by_the_cost_of_their_maps(
    lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = LANDMARK_MAPS.landmarks
    worst = [np.full(few, number) for number in range(6)]
    right = lower.true_places()[:few]
    starts = [*worst, right]
    placed = np.arange(len(starts))[:, None]
    monkeypatch.setattr(candidates_module, "assignments", lambda *_: placed)
    monkeypatch.setattr(candidates_module, "distinct", lambda *_: list(range(len(starts))))
    monkeypatch.setattr(candidates_module, "place_few", lambda _, there, *__: starts[int(there[0])])
    with retune(PART_CANDIDATES, extended=1):
        (found,) = _search(np.zeros(1, dtype=int), lower.everywhere)
    assert lower.whole.between[found, lower.true_places()].mean() < 0.1


def test_given_map_is_registered_regardless_of_its_cost(lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch) -> None:
    maps = [np.roll(lower.true_places(), shift) for shift in (0, 40, 80, 120)]
    monkeypatch.setattr(candidates_module, "_search", lambda *_: maps[:3])
    monkeypatch.setattr(
        candidates_module, "_map_cost", lambda places, _: float(next(i for i, one in enumerate(maps) if one is places))
    )
    monkeypatch.setattr(candidates_module, "_register", lambda one: SimpleNamespace(places=one.places, cost=one.cost))
    found = rough_candidates([lower.everywhere], [np.arange(3)], 2, given=[maps[3]])
    assert [one.places is each for one, each in zip(found, (maps[0], maps[1], maps[3]), strict=True)] == [True] * 3


def test_best_fragment_maps_of_both_searches_are_registered_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole, nothing = on_a_line(0.0, 0.1, 0.2, 0.3), Any
    whole.is_fragment = True
    region: Any = SimpleNamespace(part=whole, whole=whole, is_everywhere=True, is_between_fragments=True)

    def of_places(fit: float, *places: int) -> PartCandidate:
        return PartCandidate(region, np.array(places), nothing, {"fit": fit})  # type: ignore[arg-type]

    def registered(one: PartCandidate) -> PartCandidate:
        return replace(one, scores={"fit": one.scores["fit"] - (3.5 if one in there[1:] else 0.0)})

    there = [of_places(1.0, 0, 1), of_places(4.0, 2, 3), of_places(5.0, 3, 2)]  # the last one is not registered again
    rigid = [of_places(2.0, 1, 0), of_places(3.0, 0, 1)]

    def found_by(candidates: list[PartCandidate]) -> Callable[..., list[PartCandidate]]:
        def search(*_: object, **__: object) -> list[PartCandidate]:
            for fraction in (0.0, 0.5, 1.0):
                advance(fraction)
            return candidates

        return search

    monkeypatch.setattr(candidates_module, "landmark_sets", lambda *_: [])
    monkeypatch.setattr(candidates_module, "_fine_candidates", found_by(there))
    monkeypatch.setattr(candidates_module, "_placed_candidates", found_by(rigid))
    monkeypatch.setattr(candidates_module, "_register", registered)
    result, reports = reports_of(lambda: part_candidates([region]))
    fractions = [report.fraction for report in reports]
    assert fractions[:6] == pytest.approx([0.0, 0.2, 0.4, 0.4, 0.6, 0.8])
    assert fractions == sorted(fractions)
    assert [one.scores["fit"] for one in result] == [0.5, 1.0, 2.0, 5.0]


# --- partners -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted(lower: PartAndWhole) -> RegisteredPart:
    return register_part(lower.true_places(), lower.part, lower.whole, PART_REGISTRATION.fine)


def surface_and_shapes(pair: PartAndWhole, part_is_target: bool = True) -> Pair:
    """The whole and its part, as source and target or the other way round."""
    made, shapes = (pair.made_whole, pair.made_part), (pair.whole.shape, pair.part.shape)
    step = 1 if part_is_target else -1
    source, target = made[::step]
    return Pair(source.surface, target.surface, *shapes[::step], 60, 20)


@pytest.mark.parametrize("part_is_target", [True, False])
def test_map_of_whole_shapes_gives_the_places_of_a_part(lower: PartAndWhole, part_is_target: bool) -> None:
    true, whole = lower.true_places(), lower.whole
    of_whole = np.argmin(whole.shape.distances_between[true], axis=0)
    as_wholes: Any = SimpleNamespace(sample_map=true if part_is_target else of_whole)
    places = places_of(as_wholes, surface_and_shapes(lower, part_is_target))
    assert whole.between[places, true].mean() < 0.05


@pytest.mark.parametrize("upright", [False, True])
def test_up_axis_is_evidence_between_upright_fragments(
    lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch, upright: bool
) -> None:
    made = _register(_Found(0.0, lower.everywhere, lower.true_places()))
    made = replace(made, scores=made.scores | {UPRIGHT: 0.6})
    monkeypatch.setattr(part_match, "part_candidates", lambda *_: [made])
    (one,) = match_part(surface_and_shapes(lower), upright=upright)
    expected = made.scores["fit"] + (0.6 * EVIDENCE_WEIGHTS[UPRIGHT] if upright else 0.0)
    assert one.scores["total"] - curvature_score(one.scores) == pytest.approx(expected)


@pytest.mark.parametrize("is_everywhere", [True, False])
def test_a_small_part_may_point_anywhere(
    lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch, is_everywhere: bool
) -> None:
    given, region = [], SimpleNamespace(is_everywhere=is_everywhere, is_between_fragments=False)
    monkeypatch.setattr(part_match, "is_small", lambda *_: True)
    monkeypatch.setattr(part_match, "find_regions", lambda *_: [region])
    monkeypatch.setattr(part_match, "part_candidates", lambda *those: given.append(those[-1]) or [])
    assert match_part(surface_and_shapes(lower), upright=True) == []
    assert given == [is_everywhere]


def candidate(
    region: Region, match: Integers, fit: float = 0.0, size: tuple[int, int] = (20, 40), extent: float = 1.0
) -> Candidate:
    scores, nothing = {"fit": fit, "total": fit, "extent": extent}, cast(Any, None)
    placed = PartCandidate(region, match, nothing, scores)
    return Candidate("", False, False, np.eye(*size), np.eye(*size[::-1]), match, None, None, 0.0, scores, placed)


def test_whole_has_partners_only_where_the_part_is_placed(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    part, whole = lower.part.shape, lower.whole.shape
    found, has_partner = _on_part(fitted, part, whole, PART_MATCH.residual)
    on_part = np.max(lower.made_whole.directions @ lower.made_part.directions.T, axis=1) > 0.99
    assert 0.2 < on_part.mean() < 0.8
    assert (has_partner == on_part).mean() > 0.9
    off = np.linalg.norm(found.interpolate(fitted.positions) - whole.mesh.vertices, axis=1)
    assert off[has_partner].max() < PART_MATCH.residual
    # Vertices with opposite normals have none.
    inside_out = replace(fitted, normals=-fitted.normals)
    assert _on_part(inside_out, part, whole, PART_MATCH.residual)[1].mean() < 0.1


def test_part_has_partners_where_distance_normals_and_limb_agree(
    lower: PartAndWhole, fitted: RegisteredPart, monkeypatch: pytest.MonkeyPatch
) -> None:
    n = len(fitted.residual)
    count = n // 4

    def bad(number: int) -> np.ndarray:
        return np.arange(n) // count == number

    made = replace(
        fitted,
        residual=np.where(bad(0), 0.04, 0.02),
        agreement=np.where(bad(1), -0.1, 0.1),
        is_near=~bad(2),
    )

    monkeypatch.setattr(part_match, "register_part", lambda *_: made)
    found = fit_part(surface_and_shapes(lower), candidate(lower.everywhere, lower.true_places()))
    np.testing.assert_array_equal(found.partners.target, ~(bad(0) | bad(1) | bad(2)))
    np.testing.assert_array_equal(found.fit.fits, found.partners.target)
    assert 0.2 < found.partners.source.mean() < 0.8
    assert found.fit.surface_map is fitted.closest
    back = fit_part(surface_and_shapes(lower, False), candidate(lower.everywhere, lower.true_places()))
    assert back.back is fitted.closest
    np.testing.assert_array_equal(back.fit.surface_map.triangle, found.back.triangle)
    np.testing.assert_array_equal(back.partners.source, found.partners.target)
    np.testing.assert_array_equal(back.partners.target, found.partners.source)


@pytest.mark.parametrize("part_is_target", [True, False])
def test_constant_function_maps_to_itself_at_unit_area(
    lower: PartAndWhole, fitted: RegisteredPart, monkeypatch: pytest.MonkeyPatch, part_is_target: bool
) -> None:
    monkeypatch.setattr(part_match, "register_part", lambda *_: fitted)
    pair = surface_and_shapes(lower, part_is_target)
    refined = dense_map(pair, candidate(lower.everywhere, lower.true_places()))
    assert abs(refined.functional_map[0, 0]) == pytest.approx(1, abs=1e-6)
    assert refined.functional_map.shape == (20, 40)


@pytest.mark.parametrize("part_is_target", [True, False])
def test_candidate_maps_target_samples_to_true_source_samples(lower: PartAndWhole, part_is_target: bool) -> None:
    one = _register(_Found(0.0, lower.everywhere, lower.true_places()))
    pair = surface_and_shapes(lower, part_is_target)
    found = _candidate(one, pair, lambda *_: {}, upright=False)
    assert not found.mirrored
    assert not found.reverses_orientation
    target, source = pair.target_shape, pair.source_shape
    made = (lower.made_part, lower.made_whole) if part_is_target else (lower.made_whole, lower.made_part)
    here, there = (of.directions[shape.search.samples] for of, shape in zip(made, (target, source), strict=True))
    apart = np.degrees(np.arccos(np.clip(np.einsum("sx,sx->s", here, there[found.sample_map]), -1, 1)))
    # Places that the part lacks have no image on it.
    on_part = (here @ lower.made_part.directions.T).max(axis=1) > 0.99
    assert np.median(apart[on_part]) < 6


# --- curvature of finished maps ------------------------------------------------------------------------------


def test_curvature_agrees_along_the_true_map_only(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    wrong = register_part(at_mirror_images(lower), lower.part, lower.whole, PART_REGISTRATION.fine)
    right, other = (curvature_agreement(one, lower.part.shape, lower.whole.shape) for one in (fitted, wrong))
    assert right > 0.8
    assert other < right - 0.2


def test_curvature_beyond_a_cut_and_on_coarse_scales_does_not_count() -> None:
    n = 40
    here = np.random.default_rng(0).normal(size=(n, 2))
    there = here.copy()
    there[:, 0] *= -1  # the coarse scale
    there[: n // 2, 1] *= -1
    part, whole = (
        SimpleNamespace(vertex_curvature=each, basis=SimpleNamespace(areas=np.ones(n))) for each in (here, there)
    )
    closest = SimpleNamespace(interpolate=lambda values: values)
    registered: Any = SimpleNamespace(closest=closest, on_cut=np.arange(n) < n // 2)
    assert curvature_agreement(registered, cast(Any, part), cast(Any, whole)) == pytest.approx(1)


def test_candidates_are_ranked_by_the_curvature_of_their_finished_maps(
    lower: PartAndWhole, fitted: RegisteredPart, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second of two similar fits has the better curvature; a third is too far behind to be finished."""
    lags = 0.0, 0.5 * PART_MATCH.finished_margin, 1.1 * PART_MATCH.finished_margin
    maps = at_mirror_images(lower), lower.true_places(), np.roll(lower.true_places(), 40)
    scores = [{"fit": -4.0 + lag, "extent": 1.0} for lag in lags]
    made = [PartCandidate(lower.everywhere, *each) for each in zip(maps, [fitted] * 3, scores, strict=True)]
    agreements = iter([0.5, 0.7, 0.85, 0.95])  # before and after the first is finished, and the second
    monkeypatch.setattr(part_match, "part_candidates", lambda *_: made)
    monkeypatch.setattr(part_match, "register_part", lambda *_: fitted)
    monkeypatch.setattr(part_match, "curvature_agreement", lambda *_: next(agreements))
    monkeypatch.setattr(part_match, "gap_area", lambda *_: 0.0)
    monkeypatch.setattr(part_match, "for_each", lambda work, items: [work(each) for each in items])
    found = match_part(surface_and_shapes(lower))
    assert [one.scores[CURVATURE] for one in found] == pytest.approx([0.9, 0.6, 0.6])
    order = maps[1], maps[0], maps[2]
    assert all(cast(Any, one.part_match).places is each for one, each in zip(found, order, strict=True))
    assert [cast(Any, one.part_match).finished is fitted for one in found] == [True, True, False]
    assert found[0].certainty > 0.9 > found[1].certainty
    gain = np.log((0.4 + CURVATURE_FLOOR) / (0.1 + CURVATURE_FLOOR)) * PART_CURVATURE.weight
    lead = found[1].scores["total"] - found[0].scores["total"]
    assert lead == pytest.approx(gain - lags[1])


@pytest.mark.parametrize("fragments", [False, True])
def test_fragments_are_not_ranked_by_curvature(
    lower: PartAndWhole, fitted: RegisteredPart, monkeypatch: pytest.MonkeyPatch, fragments: bool
) -> None:
    made = PartCandidate(lower.everywhere, lower.true_places(), fitted, {"fit": -4.0, "extent": 1.0})
    monkeypatch.setattr(part_match, "part_candidates", lambda *_: [made])
    monkeypatch.setattr(part_match, "register_part", lambda *_: fitted)
    monkeypatch.setattr(Region, "is_between_fragments", fragments)
    (one,) = match_part(surface_and_shapes(lower))
    assert (CURVATURE in one.scores) != fragments


def test_a_finished_part_is_not_registered_again(
    lower: PartAndWhole, fitted: RegisteredPart, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = candidate(lower.everywhere, lower.true_places())
    finished = replace(one, part_match=replace(cast(PartCandidate, one.part_match), finished=fitted))
    monkeypatch.setattr(part_match, "register_part", lambda *_: pytest.fail("registered again"))
    assert fit_part(surface_and_shapes(lower), finished).fit.surface_map is fitted.closest


@pytest.mark.parametrize(("agreement", "sign"), [(0.0, -1), (0.66, 0), (0.95, 1)])
def test_certainty_of_a_place_rises_with_the_agreement_of_curvature(agreement: float, sign: int) -> None:
    nowhere: Any = SimpleNamespace(is_everywhere=True)
    one = candidate(nowhere, np.zeros(10, dtype=np.int64), -3.0)
    compared = replace(one, scores=one.scores | {CURVATURE: agreement})
    assert np.sign(round(certainty_of_part(compared, [compared]) - certainty_of_part(one, [one]), 6)) == sign


def test_a_limb_on_the_other_limb_is_not_certain_however_its_curvature_agrees() -> None:
    """The scores are those of a leg that was placed on the other leg, and of an arm on the other arm."""
    nowhere: Any = SimpleNamespace(is_everywhere=True)
    for fit, extent, agreement in ((-4.58, 0.152, 0.88), (-4.89, 0.114, 0.86)):
        one = candidate(nowhere, np.zeros(10, dtype=np.int64), fit, extent=extent)
        compared = replace(one, scores=one.scores | {CURVATURE: agreement})
        assert 0.5 < certainty_of_part(compared, [compared]) < 0.9


# --- rivals and attempts ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("apart", "rivals"), [(0.05, False), (0.2, True)])
def test_maps_to_nearby_places_are_no_rivals(apart: float, rivals: bool) -> None:
    at = np.array([0.0, apart])
    shape = SimpleNamespace(nearest_distance_sample=np.arange(2))
    whole: Any = SimpleNamespace(shape=shape, between=np.abs(at[:, None] - at))
    region: Any = SimpleNamespace(whole=whole, is_everywhere=True)
    one, other = (candidate(region, np.full(10, number), -4.0) for number in (0, 1))
    alone = certainty_of_part(one, [one])
    assert alone > 0.9
    assert certainty_of_part(one, [one, other]) == pytest.approx(alone / 2 if rivals else alone)
    # A worse rival takes less certainty; a much better one leaves almost none.
    behind = certainty_of_part(one, [one, replace(other, scores={"fit": -3.9, "total": -3.9})])
    ahead = certainty_of_part(one, [one, replace(other, scores={"fit": -5.0, "total": -5.0})])
    assert behind > 0.7 * alone
    assert not rivals or ahead < 1e-2


def test_evidence_decides_between_places(lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch) -> None:
    maps = at_mirror_images(lower), lower.true_places()
    made = [_register(_Found(0.0, lower.everywhere, places)) for places in maps]
    monkeypatch.setattr(part_match, "part_candidates", lambda *_: made)
    pair = surface_and_shapes(lower)
    first, second = match_part(pair)
    assert cast(PartCandidate, first.part_match).places is made[1].places
    assert first.certainty > 100 * second.certainty

    def against_the_first(_map: Floats, samples: Integers, _anchors: object) -> dict[str, float]:
        return {"axes": 100.0 * np.array_equal(samples, first.sample_map)}

    known = match_part(pair, against_the_first)
    assert cast(PartCandidate, known[0].part_match).places is made[0].places
    totals = [one.scores["total"] - curvature_score(one.scores) for one in (known[1], first)]
    assert totals[0] == pytest.approx(totals[1] + 100 * EVIDENCE_WEIGHTS["axes"])
    # Evidence lowers a place against its rivals; the fit alone determines absolute certainty.
    assert known[1].certainty < 1e-9
    assert known[1].scores["fit"] == first.scores["fit"]


@pytest.mark.parametrize(("fit", "certainty"), [(-4.0, 0.93), (-2.87, 0.5), (-1.0, 0.013)])
def test_certainty_of_a_place_follows_its_fit(fit: float, certainty: float) -> None:
    nowhere: Any = SimpleNamespace(is_everywhere=True)
    one = candidate(nowhere, np.zeros(10, dtype=np.int64), fit)
    assert certainty_of_part(one, [one]) == pytest.approx(certainty, abs=0.01)


def test_certainty_of_a_place_falls_with_the_area_that_supports_it() -> None:
    nowhere: Any = SimpleNamespace(is_everywhere=True)
    odds = []
    for extent in (1.0, 0.5, 0.1):
        one = candidate(nowhere, np.zeros(10, dtype=np.int64), -4.0, extent=extent)
        odds.append(1 / (1 / certainty_of_part(one, [one]) - 1))
    assert odds[1] / odds[0] == pytest.approx(0.5**PART_CERTAINTY.extent, rel=0.02)
    assert 0.1**PART_CERTAINTY.extent < odds[2] / odds[0] < 0.15**PART_CERTAINTY.extent


@pytest.mark.parametrize(
    ("ratio", "differ"), [(1.0, False), (10.0, False), (1 / 10, False), (12.0, True), (1 / 12, True)]
)
def test_units_differ_where_one_shape_is_smaller_than_a_hand(lower: PartAndWhole, ratio: float, differ: bool) -> None:
    pair = surface_and_shapes(lower)
    factor = ratio * pair.target_shape.proxy.full.scale / pair.source_shape.proxy.full.scale
    assert units_differ(replace(pair, target_shape=at_scale(pair.target_shape, factor))) == differ


def test_images_next_to_a_cut_do_not_count_in_the_cost(lower: PartAndWhole) -> None:
    """Images next to a cut are ignored; the rest decides, and a smaller rest raises the cost."""
    part, places, unlike = lower.part, lower.true_places(), unlikeness(lower.part, lower.whole)
    astray = np.arange(len(places)) % 4 == 0
    wrong = np.where(astray, np.roll(places, 7), places)
    on_cut = np.isin(np.arange(len(lower.whole.between)), wrong[astray])
    costs = []
    for distance in (1.5 * PART_CANDIDATES.near_cut, 0.5 * PART_CANDIDATES.near_cut):
        whole = IncompleteShape(lower.whole.shape)
        whole.__dict__["cut_distance"] = np.where(on_cut, distance, 1.0)
        region = region_of(part, whole, unlike)
        costs.append([_map_cost(each, region) for each in (places, wrong)])
        with retune(PART_CANDIDATES, within=0.0):
            costs[-1].append(_map_cost(wrong, region))
    (_, unaware, _), (_, aware, without_share) = costs
    assert aware < unaware - 0.5
    assert without_share < aware - 0.1


def test_fit_is_penalised_by_the_area_beyond_a_cut(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    areas = lower.part.shape.basis.areas
    half = np.cumsum(areas) > 0.5 * areas.sum()
    even = replace(fitted, agreement=np.full(len(half), 0.9))
    whole, beyond = (_scores(replace(even, on_cut=each), lower.everywhere) for each in (np.zeros_like(half), half))
    assert beyond["fit"] - whole["fit"] == pytest.approx(PART_CANDIDATES.beyond * np.log(2), abs=0.02)
    assert beyond["extent"] == pytest.approx(whole["extent"] / 2, rel=0.02)


def test_part_entirely_beyond_a_cut_fits_badly_without_extent(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    beyond, within = (
        _scores(replace(fitted, on_cut=np.full(len(fitted.on_cut), on_cut)), lower.everywhere)
        for on_cut in (True, False)
    )
    assert beyond["extent"] == pytest.approx(0, abs=1e-12)
    assert np.isfinite(beyond["fit"])
    assert beyond["fit"] > within["fit"]
