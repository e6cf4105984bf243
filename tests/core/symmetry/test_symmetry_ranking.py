# SPDX-License-Identifier: GPL-3.0-or-later
"""Rank self-maps as symmetries: each criterion counts, and none decides alone."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.symmetry import ranking
from zoomout_core.symmetry.involution import displacement, mean_distance, order_of
from zoomout_core.symmetry.ranking import SURE_SYMMETRY_CERTAINTY, is_no_part_of_identity, rank_symmetries

SIDE = 10
AT = (np.stack(np.divmod(np.arange(SIDE**2), SIDE), axis=1) + 0.5) / SIDE
# Scores of a right map of a body.
GOOD = {"commutativity": 0.6, "distance": 0.03, "place": 0.02, "curvature": 0.9}


def shape_at(places: np.ndarray, pseudo_scalars: np.ndarray | None = None) -> ShapeAnalysis:
    """Stand-in for a shape with samples (s, d) in a unit cube and pseudo-scalars (s, p), zero by default."""
    count = len(places)
    between = np.linalg.norm(places[:, None] - places, axis=2)
    values = np.zeros((count, 1)) if pseudo_scalars is None else pseudo_scalars
    parts = {
        "weights": np.full(count, 1 / count),
        "distances_between": between,
        "nearest_distance_sample": np.arange(count),
        "descriptors": (None, values),
        "search": SimpleNamespace(samples=np.arange(count), rows=np.eye(count)),
        "basis": SimpleNamespace(eigenvectors=np.eye(count)),
    }
    return cast(ShapeAnalysis, SimpleNamespace(**parts))


def image(places: np.ndarray) -> np.ndarray:
    """(s,) samples nearest to places (s, 2)."""
    return np.argmin(np.linalg.norm(AT[:, None] - places[:, None].transpose(1, 0, 2), axis=2), axis=0)


LEFT_RIGHT, UP_DOWN = image(AT * [-1, 1] + [1, 0]), image(AT * [1, -1] + [0, 1])
HALF_TURN = LEFT_RIGHT[UP_DOWN]


def candidate(sample_map: np.ndarray, reverses: bool = True, **scores: float) -> Candidate:
    nothing = np.eye(1)
    return Candidate("", reverses, reverses, nothing, nothing, sample_map, None, None, 0.0, GOOD | scores)


@pytest.fixture(autouse=True)
def rigid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable the alignment before ranking."""
    monkeypatch.setattr(ranking, "map_after_alignment", lambda sample_map, *_: (sample_map, None))


@pytest.fixture
def square() -> ShapeAnalysis:
    return shape_at(AT)


@pytest.mark.parametrize(
    ("criterion", "better", "worse"),
    [("commutativity", 0.5, 0.7), ("distance", 0.02, 0.05), ("place", 0.01, 0.03), ("curvature", 0.95, 0.8)],
)
def test_each_criterion_ranks_the_better_map_first(
    square: ShapeAnalysis, criterion: str, better: float, worse: float
) -> None:
    for maps in ((LEFT_RIGHT, UP_DOWN), (UP_DOWN, LEFT_RIGHT)):
        one, other = rank_symmetries(
            [candidate(maps[0], **{criterion: worse}), candidate(maps[1], **{criterion: better})], square
        )
        assert (one.sample_map == maps[1]).all()
        assert one.certainty > other.certainty
        assert one.scores["total"] < other.scores["total"]


def test_doubled_errors_weigh_by_the_reliability_of_the_criterion(square: ShapeAnalysis) -> None:
    def total(**scores: float) -> float:
        (one,) = rank_symmetries([candidate(LEFT_RIGHT, **scores)], square)
        return one.scores["total"]

    twice = [
        total(**{name: 2 * GOOD[name]} if name != "curvature" else {name: 1 - 2 * (1 - GOOD[name])}) - total()
        for name in ("commutativity", "place", "distance", "curvature")
    ]
    (half_as_far,) = rank_symmetries([candidate(np.where(AT[:, 1] > 0.5, LEFT_RIGHT, np.arange(len(AT))))], square)
    # Each weighs 1.2 to 1.75 times as much as the next, as fitted to the benchmark.
    for more, less in pairwise([half_as_far.scores["total"] - total(), *twice]):
        assert 1.2 < more / less < 1.75
    # Pseudo-scalars of the wrong sign cost 1.5 to 3 times as much as doubling the error of commutativity.
    lopsided = shape_at(AT, np.column_stack([AT[:, 0] - 0.5]))
    first, second = rank_symmetries([candidate(LEFT_RIGHT), candidate(UP_DOWN)], lopsided)
    assert 1.5 < (second.scores["total"] - first.scores["total"]) / twice[0] < 3


@pytest.mark.parametrize(
    ("criterion", "values"),
    [("commutativity", (0.09, 1e-3)), ("distance", (9e-3, 1e-5)), ("place", (1.9e-3, 1e-5)), ("curvature", (0.991, 1))],
)
def test_errors_within_the_accuracy_of_a_mesh_are_equal(
    square: ShapeAnalysis, criterion: str, values: tuple[float, float]
) -> None:
    maps = [candidate(m, **{criterion: value}) for m, value in zip((LEFT_RIGHT, UP_DOWN), values, strict=True)]
    one, other = rank_symmetries(maps, square)
    assert one.scores["total"] == pytest.approx(other.scores["total"])


def test_map_with_consistent_pseudo_scalars_ranks_first() -> None:
    lopsided = shape_at(AT, np.column_stack([AT[:, 0] - 0.5, (AT[:, 0] - 0.5) ** 3]))
    one, other = rank_symmetries([candidate(UP_DOWN), candidate(LEFT_RIGHT)], lopsided)
    assert (one.sample_map == LEFT_RIGHT).all()
    assert (one.scores["fine handedness"], other.scores["fine handedness"]) == pytest.approx((1, -1))
    one, other = rank_symmetries([candidate(LEFT_RIGHT, False), candidate(UP_DOWN, False)], lopsided)
    assert (one.sample_map == UP_DOWN).all()


def test_map_that_moves_more_wins_at_equal_errors(square: ShapeAnalysis) -> None:
    half = np.where(AT[:, 1] > 0.5, LEFT_RIGHT, np.arange(len(AT)))
    one, other = rank_symmetries([candidate(half), candidate(LEFT_RIGHT)], square)
    assert (one.sample_map == LEFT_RIGHT).all()
    assert one.scores["moved"] == pytest.approx(2 * other.scores["moved"])


def test_rotation_must_be_clearly_better_than_a_reflection(square: ShapeAnalysis) -> None:
    def first_reverses(place: float) -> bool:
        # Both have the same images but count as two maps.
        first, _ = rank_symmetries([candidate(LEFT_RIGHT, False, place=place), candidate(LEFT_RIGHT)], square)
        return first.reverses_orientation

    assert first_reverses(GOOD["place"])
    assert first_reverses(0.7 * GOOD["place"])
    assert not first_reverses(0.2 * GOOD["place"])


def test_maps_to_nearly_the_same_places_count_as_one(square: ShapeAnalysis) -> None:
    # Maps that are 0.07 off on average count as one, those that are 0.2 off as two.
    for share, count in ((0.7, 1), (1.0, 2)):
        off = image(np.clip(AT[LEFT_RIGHT] + [0, 0.1 if share < 1 else 0.25], 0, 0.95))
        nearly = np.where(np.arange(len(AT)) < share * len(AT), off, LEFT_RIGHT)
        found = rank_symmetries([candidate(nearly, place=0.03), candidate(LEFT_RIGHT)], square)
        assert len(found) == count
        assert (found[0].sample_map == LEFT_RIGHT).all()


def certainties(square: ShapeAnalysis, *candidates: Candidate) -> list[float]:
    return [one.certainty for one in rank_symmetries(list(candidates), square)]


def test_certainty_grows_with_the_lead_up_to_a_limit(square: ShapeAnalysis) -> None:
    rival = [
        certainties(square, candidate(LEFT_RIGHT), candidate(UP_DOWN, place=place)) for place in (0.021, 0.04, 0.2, 2)
    ]
    first = [one for one, _ in rival]
    assert first == sorted(first)
    assert first[0] < 0.7 < 0.9 < first[2]
    assert first[1] < first[2] - 0.02
    assert first[2] == pytest.approx(first[3])
    assert certainties(square, candidate(LEFT_RIGHT)) == pytest.approx([first[3]])
    behind = [other for _, other in rival]
    assert behind == sorted(behind, reverse=True)
    assert behind[2] < 0.1


def test_bad_map_without_rivals_is_uncertain(square: ShapeAnalysis) -> None:
    (certainty,) = certainties(square, candidate(LEFT_RIGHT, commutativity=3, distance=0.3, place=0.2, curvature=0.2))
    assert certainty < 0.5
    (good,) = certainties(square, candidate(LEFT_RIGHT))
    assert good > 0.9


def test_only_inexact_symmetries_are_rivals(square: ShapeAnalysis) -> None:
    maps = LEFT_RIGHT, UP_DOWN
    assert min(certainties(square, *(candidate(one, commutativity=0.12) for one in maps))) > SURE_SYMMETRY_CERTAINTY
    assert max(certainties(square, *(candidate(one) for one in maps))) < 0.8
    # A map that commutes well but fails all other criteria is no rival.
    bad = {"distance": 1.0, "place": 1.0, "curvature": -0.5}
    one, other = certainties(
        square,
        candidate(LEFT_RIGHT, commutativity=0.3, place=0.002, distance=0.01),
        candidate(UP_DOWN, commutativity=0.3, **bad),
    )
    assert other < 0.1 < 0.9 < one


def test_exact_symmetry_loses_certainty_only_behind_another(square: ShapeAnalysis) -> None:
    exact = {"commutativity": 0.4, "distance": 0.3}
    (alone,) = certainties(square, candidate(LEFT_RIGHT, place=1.0, **exact))
    level, behind = (
        certainties(square, candidate(LEFT_RIGHT, place=1.0, **exact), candidate(UP_DOWN, place=place, **exact))[1]
        for place in (1.0, 0.9)
    )
    # The error of commutativity alone gives 0.76.
    assert (alone, level) == pytest.approx((0.761, 0.761), abs=1e-3)
    assert behind < level - 0.02


def test_certain_reflection_ranks_before_a_certain_rotation(square: ShapeAnalysis) -> None:
    tried = []
    for worse in np.geomspace(0.02, 5, 60):
        found = rank_symmetries(
            [
                candidate(HALF_TURN, False, commutativity=0.12, place=0.002, distance=0.01),
                candidate(LEFT_RIGHT, commutativity=0.12, place=worse, distance=worse),
            ],
            square,
        )
        by_kind = {one.reverses_orientation: one.certainty for one in found}
        assert by_kind[False] > SURE_SYMMETRY_CERTAINTY
        assert found[0].reverses_orientation == (by_kind[True] >= SURE_SYMMETRY_CERTAINTY)
        tried.append(by_kind[True])
    assert min(tried) < 0.5
    assert max(tried) > SURE_SYMMETRY_CERTAINTY


# --- displacement by maps -----------------------------------------------------------------------------------


def test_symmetry_must_move_nearly_all_samples(square: ShapeAnalysis) -> None:
    def fixing(share: float) -> np.ndarray:
        return np.where(AT[:, 1] < share, np.arange(len(AT)), far)

    far = image((AT + np.array([0.5, 0])) % 1)
    assert is_no_part_of_identity(fixing(0.1), False, square)
    assert not is_no_part_of_identity(fixing(0.3), False, square)
    assert is_no_part_of_identity(fixing(0.3), True, square)
    assert not is_no_part_of_identity(fixing(0.6), True, square)
    assert is_no_part_of_identity(LEFT_RIGHT, True, square)
    assert not is_no_part_of_identity(np.arange(len(AT)), True, square)


def test_small_displacements_count_as_fixed() -> None:
    for spacing, moves in ((0.02, False), (0.3, True)):
        row = np.arange(200)[:, None] * np.array([[spacing, 0.0]])
        assert is_no_part_of_identity(np.roll(np.arange(200), 1), True, shape_at(row)) == moves


def ring(count: int, length: float) -> ShapeAnalysis:
    shape = shape_at(np.zeros((count, 2)))
    apart = np.abs(np.arange(count)[:, None] - np.arange(count))
    vars(shape)["distances_between"] = np.minimum(apart, count - apart) * length / count
    return shape


@pytest.mark.parametrize("order", [1, 2, 3, 5, 12, 13])
def test_order_of_a_rotation_is_found_up_to_twelve(order: int) -> None:
    count = 780
    turn = np.roll(np.arange(count), count // order)
    assert order_of(turn, ring(count, 4.0)) == (order if order <= 12 else 0)
    assert mean_distance(turn, ring(count, 4.0)) == pytest.approx(0 if order == 1 else 4 / order)


@pytest.mark.parametrize(
    ("length", "off", "back"),
    [(4.0, 1, True), (4.0, 5, True), (4.0, 12, False), (0.4, 9, True), (0.4, 14, False)],
)
def test_half_turn_tolerates_a_small_return_error(length: float, off: int, back: bool) -> None:
    # Each application overshoots a half turn by `off`, so two of them miss by twice as much.
    count = 120
    turn = np.roll(np.arange(count), -(count // 2 + off))
    assert (order_of(turn, ring(count, length)) == 2) == back


def test_displacement_is_the_distance_that_each_sample_moves() -> None:
    moved = displacement(np.array([1, 1, 0]), shape_at(np.array([[0.0, 0], [3, 0], [3, 4]])))
    assert moved == pytest.approx([3, 0, 5])
