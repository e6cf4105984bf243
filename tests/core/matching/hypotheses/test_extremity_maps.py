# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps from pairings of extremities: which are tried, which are kept, and their anchors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.sparse.csgraph import dijkstra
from shapes import sheet

from zoomout_core.matching.hypotheses.extremities import (
    EXTREMITIES,
    Extremities,
    _all_pairings,
    _average_distance,
    _levels,
    cheapest_pairings,
    extremities,
    extremity_hypotheses,
    more_extremity_hypotheses,
    pairings,
)
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.landmark_features import LandmarkFeatures
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.tuning import retune

SOURCE, TARGET = creature(350), creature(320, seed=1)


def shape_of(surface: Surface, k: int = 40) -> ShapeAnalysis:
    return analyse(surface.working.part(0)[0], k, 150, 0)


@pytest.fixture(scope="module")
def shapes() -> tuple[ShapeAnalysis, ShapeAnalysis]:
    return shape_of(SOURCE.surface), shape_of(TARGET.surface)


def test_average_distance_is_that_to_the_whole_surface(shapes) -> None:
    shape = shapes[0]
    exact = dijkstra(edge_graph(shape.mesh.vertices, shape.mesh.triangles)) @ shape.basis.areas
    np.testing.assert_allclose(_average_distance(shape), exact, rtol=0.05)


def test_features_of_the_same_tips_are_computed_once(shapes, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen: list[bytes] = []
    features = LandmarkFeatures.features

    def counting(places: LandmarkFeatures, tips: np.ndarray, side: int = 1) -> np.ndarray:
        chosen.append(tips.tobytes())
        return features(places, tips, side)

    monkeypatch.setattr(LandmarkFeatures, "features", counting)
    tried = _all_pairings(extremities(shapes[1]), extremities(shapes[0]))
    maps = extremity_hypotheses(*shapes)
    distinct = len({of_target.tobytes() for of_target, _ in tried})
    assert distinct < len(tried)
    assert len(chosen) == distinct + len(tried) + 2 * len(maps)


def test_levels_are_at_common_drops_of_persistence() -> None:
    one = np.array([1.0, 0.9, 0.8, 0.75, 0.3, 0.28, 0.1, 0.09])
    other = np.array([2.0, 1.9, 1.8, 1.7, 0.7, 0.6, 0.2, 0.19])
    assert _levels(one, other)[:2] == [6, 4]
    assert _levels(other, one)[:2] == [6, 4]
    # A drop on only one shape does not count.
    even = np.array([1.0, 0.9, 0.8, 0.75, 0.7, 0.65, 0.2, 0.19])
    assert _levels(one, even)[0] == _levels(even, one)[0] == 6
    assert set(_levels(one[:5], other)) <= {3, 4}
    after_four = np.array([1.0, 1, 1, 1, 0.5, 0.5, 0.35, 0.35])
    after_five = np.array([1.0, 1, 1, 1, 1, 0.5, 0.35, 0.35])
    assert _levels(after_four, after_five)[0] == _levels(after_five, after_four)[0] == 6


def test_pairings_of_all_levels_alternate() -> None:
    between = np.abs(np.arange(6.0)[:, None] ** 1.5 - np.arange(6.0) ** 1.5)
    persistence = np.array([1.0, 0.9, 0.85, 0.8, 0.2, 0.15])
    tips = Extremities(LandmarkFeatures(np.arange(6), between, np.zeros((6, 6, 6))), between.mean(axis=1), persistence)
    sizes = [len(of_first) for of_first, _ in _all_pairings(tips, tips)]
    assert sizes[0] == 6
    assert 4 in sizes[1:3]


@pytest.mark.parametrize("order", [[1, 2, 0], [2, 1, 0]])
def test_tips_are_distinguished_by_average_distance(order: list[int]) -> None:
    # Three equidistant tips of equal persistence.
    places, average = (
        LandmarkFeatures(np.arange(3), np.ones((3, 3)) - np.eye(3), np.zeros((3, 3, 3))),
        np.array([2, 1, 1.5]),
    )
    tips, other = (Extremities(places, each, np.ones(3)) for each in (average, average[order]))
    of_tips, of_other = pairings(tips, other)[0]
    np.testing.assert_array_equal(average[order][of_other], average[of_tips])


def test_pairing_cost_combines_mean_single_and_mutual_costs() -> None:
    # Compare the cost of one bad pair with that of two inconsistent pairs.
    single, mutual = np.zeros((2, 2)), np.zeros((2, 2, 2, 2))
    single[0, 0] = 1.0
    for i, j in ((1, 0), (0, 1)):
        mutual[i, 1 - i, j, 1 - j] = 0.4
    left, right = cheapest_pairings(single, mutual, 2)
    np.testing.assert_array_equal(right[0], [1, 0])
    mutual *= 1.5
    assert cheapest_pairings(single, mutual, 2)[1][0].tolist() == [0, 1]
    np.testing.assert_array_equal(left, [[0, 1]] * len(left))


def test_extremities_are_sorted_by_persistence(shapes) -> None:
    found = extremities(shapes[0])
    assert (np.diff(found.persistence) <= 0).all()
    assert found.persistence[4] > 0.1
    np.testing.assert_array_equal(found.average_distance, _average_distance(shapes[0])[found.vertices])
    two = found.leading(2)
    np.testing.assert_array_equal(two.vertices, found.vertices[:2])
    np.testing.assert_array_equal(two.between, found.between[:2, :2])


def test_anchors_of_the_best_hypothesis_give_the_true_map(shapes) -> None:
    source, target = shapes
    hypotheses = extremity_hypotheses(source, target)
    truth = true_vertex(SOURCE, TARGET)
    off = []
    for hypothesis in hypotheses:
        assert hypothesis.anchors is not None
        image = np.linalg.norm(hypothesis.anchors.target[:, None] - hypothesis.anchors.source, axis=2).argmin(axis=1)
        off.append(np.linalg.norm(source.mesh.vertices[image] - source.mesh.vertices[truth], axis=1).mean())
    assert min(off) < 0.12
    assert 3 <= len(hypotheses) <= 16
    assert not any("mirrored" in hypothesis.origin for hypothesis in hypotheses)  # a closed shape has known sides


def test_cloth_gets_hypotheses_for_both_sides() -> None:
    source, target = shape_of(sheet(250, seed=0).surface), shape_of(sheet(220, seed=1).surface)
    sides = ["mirrored" in hypothesis.origin for hypothesis in extremity_hypotheses(source, target)]
    assert sides == sorted(sides)
    assert 0 < sum(sides) < len(sides)


@pytest.mark.parametrize("cloth_first", [True, False])
def test_sides_are_known_only_if_known_for_both_shapes(shapes, cloth_first: bool) -> None:
    cloth = shape_of(sheet(200).surface)
    both = (cloth, shapes[1]) if cloth_first else (shapes[0], cloth)
    assert {"mirrored" in hypothesis.origin for hypothesis in extremity_hypotheses(*both)} == {False, True}


def test_few_functions_suffice_for_extremity_maps(shapes) -> None:
    few = shape_of(TARGET.surface, 7)
    for both in ((shapes[0], few), (few, shapes[1])):
        assert extremity_hypotheses(*both, wanted=lambda of_target, _: len(of_target) == 3)


@pytest.mark.parametrize(("cloth", "sides"), [(False, (1,)), (True, (1, -1))])
def test_sides_default_to_the_possible_ones(shapes, cloth: bool, sides: tuple[int, ...]) -> None:
    both = (shape_of(sheet(200).surface), shapes[1]) if cloth else shapes

    def few(of_target: np.ndarray, _: np.ndarray) -> bool:
        return len(of_target) == 3

    usual, same = (extremity_hypotheses(*both, wanted=few, **given) for given in ({}, {"sides": sides}))
    assert usual
    for one, other in zip(usual, same, strict=True):
        np.testing.assert_array_equal(one.anchors.target, other.anchors.target)


def test_evidence_decides_which_pairings_are_kept(shapes) -> None:
    calls: list[int] = []

    def against_all_but_the_last(*_: Any) -> dict[str, float]:
        calls.append(len(calls))
        return {"axes": 1000.0 / len(calls)}

    usual = [hypothesis.origin for hypothesis in extremity_hypotheses(*shapes)]
    other = [hypothesis.origin for hypothesis in extremity_hypotheses(*shapes, against_all_but_the_last)]
    assert len(calls) > len(usual)
    assert usual != other
    assert usual[0] == other[0]  # the pairings that preserve distances best are always kept


def tip_pairs(hypotheses: list[Hypothesis]) -> set[str]:
    """Pairs of tips that occur in the origin of any hypothesis."""
    return {pair for hypothesis in hypotheses for pair in hypothesis.origin.removeprefix("extremities ").split()}


def test_more_pairings_are_tried_where_no_map_is_likely(shapes) -> None:
    with retune(EXTREMITIES, kept=2, kept_consistent=1, more=9, more_consistent=4, lesser_persistence=0.5):
        usual, more = extremity_hypotheses(*shapes), more_extremity_hypotheses(*shapes)
    assert len(usual) == 2
    assert 5 < len(more) <= 9 + 2


def test_lesser_tips_are_paired_where_no_map_is_likely() -> None:
    # With this threshold the head, the least persistent of six tips, is not an extremity.
    with retune(EXTREMITIES, persistence=0.115, lesser_persistence=0.05, more=1, more_consistent=1):
        shapes = shape_of(SOURCE.surface), shape_of(TARGET.surface)
        assert [len(extremities(shape).vertices) for shape in shapes] == [5, 5]
        assert "5-5" not in tip_pairs(extremity_hypotheses(*shapes))
        assert "5-5" in tip_pairs(more_extremity_hypotheses(*shapes))
