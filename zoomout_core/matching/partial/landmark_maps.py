# SPDX-License-Identifier: GPL-3.0-or-later
"""Extend landmarks on a shape that may lack pieces to a map of places, by distances, which cuts hardly change.

Eigenfunctions are not used, because those of a part and of a whole have little in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class LandmarkMapTuning(Tuning, set_by="partial"):
    """How landmarks are extended to maps; lengths are those of the larger shape at unit area."""

    tolerance: float = tuned(0.05, "length", 1e-6, 10)  # tolerance of a difference of distances to a landmark
    relative_tolerance: float = tuned(0.3, "1", 0, 10)  # additional tolerance for each unit of the distance
    max_cost: float = tuned(1.5, "tolerances", 0.1, 100)  # maximum cost of a difference, in tolerances
    unlikeness: float = tuned(0.3, "1", 0, 10)  # of places, against the mean cost of differences, at first
    later_unlikeness: float = tuned(0.15, "1", 0, 10)  # the same weight in the following rounds
    rounds: int = tuned(3, "rounds", 0, 100)  # number of rounds in which mapped places are landmarks for the others
    landmarks: int = tuned(40, "places", 3, 1000)  # number of landmarks in these rounds


LANDMARK_MAPS = LandmarkMapTuning()


def extend_landmarks(
    landmarks: Integers, placed: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape
) -> Integers:
    """(d_t,) the source's place for each place of the target, by distances to landmarks (m,), placed on the source."""
    place = _by_landmarks(landmarks, placed, LANDMARK_MAPS.unlikeness * unlike, target, source)
    few = np.arange(min(LANDMARK_MAPS.landmarks, len(place)))
    for _ in range(LANDMARK_MAPS.rounds):
        place = _by_landmarks(few, place[few], LANDMARK_MAPS.later_unlikeness * unlike, target, source)
    return place


def _by_landmarks(
    landmarks: Integers, placed: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape
) -> Integers:
    here, there = target.between[landmarks].astype(np.float32), source.between[placed].astype(np.float32)
    weight = 1 / (len(landmarks) * (LANDMARK_MAPS.tolerance + LANDMARK_MAPS.relative_tolerance * here))
    most = np.float32(LANDMARK_MAPS.max_cost / len(landmarks))
    cost = unlike.astype(np.float32)
    difference = np.empty_like(cost)
    for from_here, from_there, weighed in zip(here, there, weight, strict=True):
        np.subtract(from_here[:, None], from_there, out=difference)
        np.abs(difference, out=difference)
        difference *= weighed[:, None]
        cost += np.minimum(difference, most, out=difference)
    return np.asarray(np.argmin(cost, axis=1))
