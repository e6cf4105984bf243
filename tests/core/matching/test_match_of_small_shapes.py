# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial hypotheses, choice of bodies and notes of a match, on shapes of few vertices."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from creatures import creature, directions, true_vertex
from reports import fractions_of, reports_of
from scipy.spatial import ConvexHull

import zoomout_core as zo
from zoomout_core.matching import pipeline
from zoomout_core.matching import result as result_module
from zoomout_core.matching.components.bodies import Bodies
from zoomout_core.matching.constraints import Constraints
from zoomout_core.matching.hypotheses import collect
from zoomout_core.matching.hypotheses.given import given_hypothesis
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.hypotheses.landmarks import landmark_hypothesis
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.pair import LandmarkError, Pair
from zoomout_core.matching.preparation import prepare as preparation
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.proxy import proxy_size
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.refinement import dense_map
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.registration.nonrigid_icp import Fit
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.progress import Progress, advance, stage

pytestmark = pytest.mark.usefixtures("few_candidates")

SOURCE, TARGET = creature(260), creature(240, seed=1)
TRUTH = true_vertex(SOURCE, TARGET)
NOTHING = Constraints(None, np.zeros((0, 3)), [])


@pytest.fixture(scope="module")
def watched() -> tuple[zo.MatchResult, list[Progress]]:
    return reports_of(lambda: zo.match(SOURCE.surface, TARGET.surface, initial="proximity", k_final=30))


@pytest.fixture(scope="module")
def result(watched: tuple[zo.MatchResult, list[Progress]]) -> zo.MatchResult:
    return watched[0]


def is_rising(seen: list[Progress]) -> bool:
    fractions = [0.0, *(each.fraction for each in seen), 1.0]
    return fractions == sorted(fractions) and max(np.diff(fractions)) < 0.5


def test_progress_rises_through_all_stages(watched: tuple[zo.MatchResult, list[Progress]]) -> None:
    result, seen = watched
    assert is_rising(seen)
    assert {"Guessing", "Comparing candidates", "Refining", "Extending to all vertices"} <= {s.stage for s in seen}
    begun = {stage: next(each.fraction for each in seen if each.stage == stage) for stage in {s.stage for s in seen}}
    assert begun["Finding the bodies"] < 0.05
    assert begun["Refining"] > 0.4
    _, again = reports_of(lambda: result.use(0))
    assert is_rising(again)
    assert again[0].fraction < 0.1


def test_scaling_by_a_power_of_two_gives_an_identical_match(result: zo.MatchResult) -> None:
    scaled = [Surface(made.surface.vertices / 1024, made.surface.triangles) for made in (SOURCE, TARGET)]
    found = zo.match(*scaled, initial="proximity", k_final=30)
    for name in ("triangle", "barycentric"):
        np.testing.assert_array_equal(getattr(found.surface_map, name), getattr(result.surface_map, name))
    np.testing.assert_array_equal(found.confidence, result.confidence)


def test_functions_given_ahead_run_in_order_after_the_analysis(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def analysed(*_: object) -> Any:
        advance(0.5)
        asked.append("made")
        return "it"

    monkeypatch.setattr(preparation, "cached_analysis", analysed)
    ahead = (lambda it: asked.append(f"{it} first"), asked.append)
    part = SOURCE.surface.working.part(0)[0]
    fractions = fractions_of(lambda: preparation.prepare_shape(part, 20, 60, 0, None, ahead))
    assert asked == ["made", "it first", "it"]
    assert fractions == sorted(fractions)
    assert 0.4 < fractions[0] < fractions[1] == fractions[-1] < 1


def test_progress_of_bending_follows_that_of_refining(result: zo.MatchResult, monkeypatch) -> None:
    def refining(*_: Any) -> Any:
        for fraction in (0.0, 0.5, 1.0):
            advance(fraction)
        return result.surface_map, result.functional_map

    def bending(refined: Any, *_: Any) -> Fit:
        for fraction in (0.0, 0.5, 1.0):
            advance(fraction)
        return Fit.of_map(refined)

    def averaging(fit: Fit, *_: Any) -> Fit:
        advance(0.5)
        advance(1.0)
        return fit

    monkeypatch.setattr(dense_map, "refine_candidate", refining)
    monkeypatch.setattr(dense_map, "refine", refining)
    monkeypatch.setattr(dense_map, "fit_nonrigid", bending)
    monkeypatch.setattr(dense_map, "average_both_ways", averaging)
    monkeypatch.setattr(dense_map, "pin_extremities", lambda *_: None)
    monkeypatch.setattr(dense_map, "confidence_of", lambda *_: (np.ones(240), 0.0))
    monkeypatch.setattr(dense_map, "partners_by_cycle", lambda *_: None)
    fractions = fractions_of(lambda: dense_map.dense_map(result.pair, result.candidates[0]))
    assert fractions == sorted(fractions)
    # The map is refined and then bent; the reverse map is only refined. Both registrations are then averaged.
    half = dense_map.AVERAGING / 2
    forwards = [fraction / half for fraction in fractions if fraction < half]
    assert forwards == pytest.approx([0.0, 0.3, 0.6, 0.6, 0.8])
    assert (dense_map.AVERAGING + 1) / 2 in fractions
    assert fractions[-1] == 1


# --- options ------------------------------------------------------------------------------------------------


def test_options_may_be_an_object_and_keywords() -> None:
    found = zo.match(SOURCE.surface, TARGET.surface, MatchOptions(initial="proximity"), k_final=12)
    assert found.pair.k_final == 12
    assert [candidate.origin for candidate in found.candidates] == ["nearest points in space"]
    with pytest.raises(TypeError, match="is not MatchOptions"):
        zo.match(SOURCE.surface, TARGET.surface, "proximity")  # type: ignore[arg-type]


# --- notes --------------------------------------------------------------------------------------------------


def notes_of(result: zo.MatchResult, certainty: float) -> tuple[str, ...]:
    sure = replace(result.candidates[0], certainty=certainty)
    return replace(result, candidates=(sure,)).use(0).notes


@pytest.mark.parametrize(
    ("certainty", "words"),
    [
        (0.8, "correct with a probability of only 80%"),
        (0.2, "correct with a probability of only 20%"),
        (0.04, "No reliable match was found (a probability of 4%)"),
    ],
)
def test_notes_report_uncertain_and_hopeless_maps(result: zo.MatchResult, certainty: float, words: str) -> None:
    assert words in notes_of(result, certainty)[0]


def test_notes_omit_the_probability_of_a_certain_map(result: zo.MatchResult) -> None:
    assert "probability" not in " ".join(notes_of(result, 0.97))


@pytest.mark.parametrize(
    ("over", "of_target", "of_source", "words"),
    [
        (0.03, 0.02, 0.02, ()),
        (0.1, 0.02, 0.02, ("flips 10% of the target",)),
        (0.03, 0.1, 0.02, ("of the target has no partner on the source",)),
        (0.03, 0.02, 0.1, ("of the source has no partner on the target",)),
    ],
)
def test_notes_report_large_flipped_or_unpaired_areas(
    result: zo.MatchResult, monkeypatch, over: float, of_target: float, of_source: float, words: tuple[str, ...]
) -> None:
    def lonely(shape: ShapeAnalysis, share: float) -> np.ndarray:
        return np.cumsum(shape.basis.areas) > share

    shapes = result.pair.source_shape, result.pair.target_shape
    partners = Partners(lonely(shapes[1], of_target), lonely(shapes[0], of_source))
    monkeypatch.setattr(dense_map, "confidence_of", lambda *_: (np.ones(240), over))
    monkeypatch.setattr(dense_map, "partners_by_cycle", lambda *_: partners)
    notes = notes_of(result, 0.97)
    assert len(notes) == len(words)
    assert all(some in note for some, note in zip(words, notes, strict=True))


def test_map_of_half_the_target_has_half_the_certainty(result: zo.MatchResult, monkeypatch: pytest.MonkeyPatch) -> None:
    lift = result_module.lift
    monkeypatch.setattr(result_module, "lift", lambda *args: lift(*args)._replace(placed=0.5))
    assert "correct with a probability of only 45%" in notes_of(result, 0.9)[0]


@pytest.mark.parametrize("given", [None, 700])
def test_proxy_has_the_requested_number_of_vertices(given: int | None) -> None:
    assert proxy_size(len(SOURCE.surface.vertices), given) == given


def test_larger_mesh_has_a_larger_proxy_within_limits() -> None:
    sizes = [proxy_size(count, "auto") for count in (10, 1000, 40_000, 10**6, 10**7)]
    assert sizes[0] == sizes[1] < sizes[2] < sizes[3] == sizes[4]


def test_certainty_falls_with_the_unplaced_area(result: zo.MatchResult) -> None:
    assert replace(result, placed=0.5).certainty == pytest.approx(0.5 * result.candidates[0].certainty)


def test_missing_candidates_are_refused(result: zo.MatchResult) -> None:
    for number in (-1, len(result.candidates)):
        with pytest.raises(ValueError, match=f"no candidate {number}: they are numbered 0 to 0"):
            result.use(number)


def test_outline_agrees_with_its_candidate(result: zo.MatchResult) -> None:
    vertices, images = result.outline(0)
    off = np.linalg.norm(SOURCE.surface.vertices[images] - TARGET.surface.vertices[vertices], axis=1)
    assert np.median(off) < 0.1 * np.sqrt(SOURCE.surface.area)


# --- initial hypotheses --------------------------------------------------------------------------------------


def hypotheses(
    pair: Pair, monkeypatch: pytest.MonkeyPatch, initial: str = "auto", known: Constraints = NOTHING, **given: Any
) -> list[Hypothesis]:
    """Generator with the identity and a mirror as the only initial maps."""
    two = [Hypothesis("identity", np.eye(5)), Hypothesis("mirror", np.diag([1.0, -1, 1, 1, 1]))]
    monkeypatch.setattr(collect, "GENERATORS", (lambda *_: two[:1], lambda *_: two[1:]))
    by_landmarks = collect.hypothesis_of_landmarks(pair, known)
    return collect.collect_hypotheses(
        pair, initial, known, known.disagreement(pair), given.get("earlier"), by_landmarks
    )


def origins(found: list[Hypothesis]) -> list[str]:
    return [each.origin for each in found]


def test_evidence_is_tried_before_generated_hypotheses(result: zo.MatchResult, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = result.pair
    earlier = Hypothesis("a given map", np.eye(5))
    known = replace(NOTHING, in_space=pair.source_shape.proxy.vertices)
    assert origins(hypotheses(pair, monkeypatch)) == ["identity", "mirror"]
    assert origins(hypotheses(pair, monkeypatch, "proximity")) == ["nearest points in space"]
    assert hypotheses(pair, monkeypatch, "given", earlier=earlier) == [earlier]
    found = hypotheses(pair, monkeypatch, known=known, earlier=earlier)
    assert origins(found) == ["a given map", "nearest points in space", "identity", "mirror"]
    assert all(each.anchors is None for each in found)


def test_landmarks_and_regions_anchor_every_hypothesis(result: zo.MatchResult, monkeypatch: pytest.MonkeyPatch) -> None:
    tips = np.array([3, 50, 120])
    legs = [np.flatnonzero(side.directions[:, 2] < -0.7) for side in (SOURCE, TARGET)]
    by_landmarks = replace(NOTHING, landmarks=(TRUTH[tips], tips))
    both = hypotheses(result.pair, monkeypatch, known=replace(by_landmarks, regions=[tuple(legs)]))
    assert origins(both) == ["3 landmarks", "identity", "mirror"]
    for each in both:
        assert each.anchors is not None
        assert each.final_anchors is each.anchors
    alone = hypotheses(result.pair, monkeypatch, known=by_landmarks)[0].anchors
    regions = hypotheses(result.pair, monkeypatch, known=replace(NOTHING, regions=[tuple(legs)]))[0].anchors
    assert both[0].anchors.source.shape[1] == alone.source.shape[1] + regions.source.shape[1]
    # Landmarks of the user weigh more than places paired by hypotheses.
    named = landmark_hypothesis(result.pair.source_shape, result.pair.target_shape, TRUTH[tips], tips).anchors
    ratio = np.abs(alone.source).sum() / np.abs(named.source).sum()
    assert 1.5 < ratio < 4


@pytest.fixture(scope="module")
def balls() -> tuple[ShapeAnalysis, ShapeAnalysis]:
    spheres = [Surface(points, ConvexHull(points).simplices) for points in (directions(200, 3), directions(180, 4))]
    one, other = (analyse(each.working.part(0)[0], 40, 100, 0) for each in spheres)
    return one, other


@pytest.mark.parametrize("number", [0, 1])
def test_all_signs_are_tried_where_a_shape_has_no_extremities(balls, result, monkeypatch, number: int) -> None:
    shapes = [result.pair.source_shape, result.pair.target_shape]
    shapes[number] = balls[number]
    pair = replace(result.pair, source_shape=shapes[0], target_shape=shapes[1])
    assert sum("signs" in origin for origin in origins(hypotheses(pair, monkeypatch))) > 20


def test_overlapping_surfaces_give_evidence_in_space(result: zo.MatchResult) -> None:
    pair = result.pair
    places = collect.gather_evidence(pair, NOTHING, None).in_space
    assert places is not None
    there = pair.source_shape.proxy.full.to_surface(places)
    np.testing.assert_allclose(there, TARGET.surface.vertices[pair.target_shape.search.samples], atol=1e-9)
    itself = replace(pair, target=pair.source)
    assert collect.gather_evidence(itself, NOTHING, None).in_space is None  # trivial for the surface itself


def test_earlier_map_is_kept_as_images_of_the_samples(result: zo.MatchResult) -> None:
    pair = result.pair
    assert collect.gather_evidence(pair, NOTHING, None).earlier is None
    samples = pair.target_shape.search.samples
    images = collect.gather_evidence(pair, NOTHING, given_hypothesis(pair, TRUTH)).earlier
    assert images is not None
    off = np.linalg.norm(SOURCE.surface.vertices[images] - TARGET.surface.vertices[samples], axis=1)
    assert np.median(off) < 0.1 * np.sqrt(SOURCE.surface.area)


# --- choice of bodies ---------------------------------------------------------------------------------------


def try_bodies(
    result: zo.MatchResult, monkeypatch: pytest.MonkeyPatch, *certainties: float | None, skins: bool = False
) -> tuple[int, float]:
    """Number of bodies tried of three, and certainty of the chosen one; None marks a body without a landmark."""
    part = SOURCE.surface.working.part(0)[0]
    bodies = [Bodies(replace(part, is_hull=skins), TARGET.surface.working.part(0)[0], 1.0, np.ones(1))] * 2
    count = 0

    def find_bodies(*_: Any) -> list[Bodies]:
        advance(0.5)
        return list(bodies)

    def tight_bodies(*_: Any) -> Bodies:
        advance(0.5)
        return bodies[0]

    def find_candidates(*_: Any) -> list[Candidate]:
        nonlocal count
        certainty = certainties[count]
        count += 1
        with stage("Guessing"):
            if certainty is None:
                raise LandmarkError("source", 0, "is elsewhere.")
        return [replace(result.candidates[0], certainty=certainty), replace(result.candidates[0], certainty=0.0)]

    def make_result(_: Pair, candidates: Any, chosen: int) -> float:
        with stage("Refining"):
            return candidates[chosen].certainty

    for name, fake in (
        ("find_bodies", find_bodies),
        ("tight_bodies", tight_bodies),
        ("_find_candidates", find_candidates),
        ("make_result", make_result),
    ):
        monkeypatch.setattr(pipeline, name, fake)
    certainty, seen = reports_of(lambda: pipeline.match(SOURCE.surface, TARGET.surface))
    assert is_rising(seen)
    return count, certainty


def test_bodies_are_tried_until_one_map_is_certain(result: zo.MatchResult, monkeypatch) -> None:
    assert try_bodies(result, monkeypatch, 0.95) == (1, 0.95)
    assert try_bodies(result, monkeypatch, 0.5, 0.6) == (2, 0.6)
    assert try_bodies(result, monkeypatch, 0.5, 0.2, skins=False) == (2, 0.5)


def test_tight_hulls_are_tried_last(result: zo.MatchResult, monkeypatch) -> None:
    assert try_bodies(result, monkeypatch, 0.3, 0.4, 0.7, skins=True) == (3, 0.7)
    assert try_bodies(result, monkeypatch, 0.3, 0.95, skins=True) == (2, 0.95)


def test_later_body_that_lacks_a_landmark_is_skipped(result: zo.MatchResult, monkeypatch) -> None:
    assert try_bodies(result, monkeypatch, 0.5, None) == (2, 0.5)
    with pytest.raises(LandmarkError, match="is elsewhere"):
        try_bodies(result, monkeypatch, None)


# --- no likely candidate ------------------------------------------------------------------------------------


def test_more_hypotheses_are_tried_only_if_no_map_is_likely(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def further(*_: Any) -> list[Hypothesis]:
        asked.append("further")
        return [Hypothesis("the right one", np.eye(8))]

    monkeypatch.setattr(collect, "GENERATORS", (lambda *_: [Hypothesis("wrong", np.diag([1.0, -1, -1, 1, 1, 1]))],))
    monkeypatch.setattr(collect, "MORE_GENERATORS", (further,))
    bent = creature(240, seed=1, bend=0.7)
    result = zo.match(SOURCE.surface, bent.surface, k_final=30)
    assert asked
    assert {one.origin for one in result.candidates} == {"wrong", "the right one"}
    assert result.candidates[0].origin == "the right one"
    asked.clear()
    monkeypatch.setattr(collect, "GENERATORS", (lambda *_: [Hypothesis("right", np.eye(8))],))
    assert [one.origin for one in zo.match(SOURCE.surface, SOURCE.surface, k_final=30).candidates] == ["right"]
    zo.match(SOURCE.surface, bent.surface, k_final=30, initial="given", initial_map=true_vertex(SOURCE, bent))
    assert not asked
