# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of places from landmarks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pieces import PartAndWhole, extend_landmarks

from zoomout_core.matching.partial.incomplete_shape import unlikeness
from zoomout_core.matching.partial.landmark_maps import LANDMARK_MAPS, place_all, place_few
from zoomout_core.matching.partial.landmark_search import landmarks_of
from zoomout_core.tuning import retune


def test_true_landmarks_are_extended_to_all_places(lower: PartAndWhole) -> None:
    part, whole = lower.part, lower.whole
    unlike = unlikeness(part, whole)
    chosen, truth = landmarks_of(part, 7), lower.true_places()
    place = extend_landmarks(chosen, truth[chosen], unlike, part, whole)
    samples, vertices = whole.shape.search.samples, part.shape.search.samples
    rough = lower.errors(samples[place], vertices[: len(place)])
    assert np.mean(rough) < 0.2
    with retune(LANDMARK_MAPS, rounds=1):
        once = extend_landmarks(chosen, truth[chosen], unlike, part, whole)
    assert not np.array_equal(once, place)


def test_places_are_assigned_by_unlikeness_and_distances(lower: PartAndWhole) -> None:
    shape = lower.whole
    every = np.arange(len(shape.between))
    few, chosen = every[: LANDMARK_MAPS.landmarks], landmarks_of(shape, 6)
    likes_next = 1 - np.roll(np.eye(len(every)), 1, axis=1)
    none = {"unlikeness": 0.0, "later_unlikeness": 0.0}
    for weight, expected in ((0.0, every), (10.0, np.roll(every, -1))):
        with retune(LANDMARK_MAPS, rounds=1, **(none | {"unlikeness": weight})):
            np.testing.assert_array_equal(place_few(chosen, chosen, likes_next, shape, shape), expected[few])
        with retune(LANDMARK_MAPS, **(none | {"later_unlikeness": weight})):
            np.testing.assert_array_equal(place_all(few, likes_next, shape, shape), expected)


@pytest.mark.parametrize("rounds", [1, 2])
def test_most_similar_of_near_places_wins_in_every_round(rounds: int) -> None:
    line: Any = SimpleNamespace(between=0.004 * np.abs(np.subtract.outer(np.arange(20), np.arange(20))))
    likes_next = 1 - np.roll(np.eye(20), 1, axis=1)
    with retune(LANDMARK_MAPS, rounds=rounds):
        found = extend_landmarks(np.array([0, 19]), np.array([0, 19]), likes_next, line, line)
    np.testing.assert_array_equal(found[:-1], np.arange(1, 20))
