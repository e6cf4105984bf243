# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks keep away from cuts, and are located by distances and neighbourhoods."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from creatures import creature
from pieces import PartAndWhole, analyse_piece

from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, unlikeness
from zoomout_core.matching.partial.landmark_search import SEARCH, assignments, distinct, landmarks_of
from zoomout_core.tuning import retune


def test_landmarks_are_spread_and_keep_away_from_cuts(lower: PartAndWhole) -> None:
    part = lower.part
    chosen = landmarks_of(part, 8)
    assert len(set(chosen)) == 8
    assert part.cut_distance[chosen[0]] > 0.9 * part.cut_distance.max() - SEARCH.mean_distance
    with retune(SEARCH, min_weight=1.0):
        unaware = landmarks_of(part, 8)
    assert part.cut_distance[chosen].min() > part.cut_distance[unaware].min()
    apart = part.between[np.ix_(chosen, chosen)] + np.eye(8)
    assert apart.min() > 0.15


def test_landmarks_of_a_shape_without_cuts_are_at_tips() -> None:
    whole = IncompleteShape(analyse_piece(creature(500)))
    first = landmarks_of(whole, 3)[0]
    assert whole.between[first].mean() > np.quantile(whole.between.mean(axis=1), 0.95)
    assert len(landmarks_of(whole, 10_000)) == len(whole.between)


def test_landmarks_around_a_place_stay_in_its_region(lower: PartAndWhole) -> None:
    part, around = lower.part, landmarks_of(lower.part, 2)[1]
    chosen = landmarks_of(part, 6, around)
    assert chosen[0] == around
    assert len(set(chosen)) == 6
    assert np.mean(part.between[around] < part.between[around, chosen].max()) <= SEARCH.region
    every = landmarks_of(part, 10_000, around)
    assert np.mean(part.between[around] <= part.between[around, every].max()) == pytest.approx(SEARCH.region, abs=0.01)
    assert len(every) == pytest.approx(SEARCH.region * len(part.between), abs=1)
    with retune(SEARCH, region=1.0):
        assert part.between[around, landmarks_of(part, 6, around)].max() > part.between[around, chosen].max()


def test_landmarks_of_a_part_are_placed_on_the_whole(lower: PartAndWhole) -> None:
    part, whole = lower.part, lower.whole
    chosen, unlike = landmarks_of(part, 7), unlikeness(part, whole)
    placed = assignments(chosen, unlike, part, whole)
    assert placed.shape[1] == 7
    assert placed.max() < SEARCH.places
    off = whole.between[placed[:50], lower.true_places()[chosen]].mean(axis=1)
    assert off.min() < 0.15
    # Only distinct assignments are kept, including the first.
    numbers = distinct(placed, whole)
    assert numbers[0] == 0
    assert len(numbers) <= SEARCH.kept
    apart = [whole.between[placed[a], placed[b]].mean() for a in numbers for b in numbers if a < b]
    assert min(apart) > SEARCH.apart


def test_assignments_are_distinct_by_cells(lower: PartAndWhole) -> None:
    part, whole = lower.part, lower.whole
    chosen, unlike = landmarks_of(part, 5), unlikeness(part, whole)
    placed = assignments(chosen, unlike, part, whole)
    count = min(SEARCH.places, len(whole.between))
    cells = np.argmin(whole.between[: SEARCH.cells, :count], axis=0)[placed]
    assert len(np.unique(cells, axis=0)) == len(placed)
    assert len(placed) <= SEARCH.width
    with retune(SEARCH, width=20):
        assert len(assignments(chosen, unlike, part, whole)) <= 20


def on_a_line(*places: float, cut: bool = False) -> Any:
    between = np.abs(np.subtract.outer(places, places))
    return SimpleNamespace(between=between, unaffected=np.full(between.shape, not cut))


@pytest.mark.parametrize(("part_is_cut", "place"), [(True, 1), (False, 2)])
def test_differences_that_a_cut_may_explain_weigh_less(part_is_cut: bool, place: int) -> None:
    # Of the two places of the second landmark, one is too near and one too far. A cut makes paths longer, so it may
    # explain a longer path on the shape that is cut.
    part = on_a_line(0, 1, cut=part_is_cut)
    whole = on_a_line(0, 0.9, 1.1, cut=not part_is_cut)
    unlike = np.array([[0.0, 1, 1], [1, 0, 0]])
    np.testing.assert_array_equal(assignments(np.arange(2), unlike, part, whole)[0], [0, place])


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize(("ratio", "is_taken"), [(0.4, True), (0.8, False)])
def test_mean_distances_weigh_twice_as_much_as_unlikeness(count: int, ratio: float, is_taken: bool) -> None:
    at = np.arange(float(count))
    # The last landmark is unlike all places at the right distance, and like one that is farther away. There, the mean
    # cost of pairs is `ratio` times the mean unlikeness.
    unlike = 1 - np.eye(count, count + 1)
    unlike[-1] = [1] * count + [0]
    tolerances = SEARCH.tolerance + SEARCH.relative_tolerance * (at[-1] - at[:-1])
    pairs = count * (count - 1) / 2
    beyond = at[-1] + ratio / count * pairs / np.sum(1 / tolerances)
    found = assignments(np.arange(count), unlike, on_a_line(*at), on_a_line(*at, beyond))[0]
    np.testing.assert_array_equal(found, [*range(count - 1), count if is_taken else count - 1])
