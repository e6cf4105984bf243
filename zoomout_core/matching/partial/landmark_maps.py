# SPDX-License-Identifier: GPL-3.0-or-later
"""Extend landmarks on a shape that may lack pieces to a map of places, by distances, which cuts hardly change.

Eigenfunctions are not used, because they differ between a part and a whole.
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
    rounds: int = tuned(2, "rounds", 1, 100)  # number of rounds in which mapped places are landmarks for the others
    landmarks: int = tuned(40, "places", 3, 1000)  # number of landmarks in these rounds


LANDMARK_MAPS = LandmarkMapTuning()
# Number of places whose costs are computed at once: their differences from 40 landmarks fit in the cache of a core.
BLOCK = 8


def place_few(
    landmarks: Integers, placed: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape
) -> Integers:
    """(f,) the source's place for the first few places of the target, by landmarks (m,), placed on the source (m,)."""
    few = np.arange(min(LANDMARK_MAPS.landmarks, len(unlike)))
    weight = LANDMARK_MAPS.unlikeness
    for _ in range(LANDMARK_MAPS.rounds):
        placed = _by_landmarks(few, landmarks, placed, weight * unlike[few], target, source)
        landmarks, weight = few, LANDMARK_MAPS.later_unlikeness
    return placed


def place_all(placed: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape) -> Integers:
    """(d_t,) the source's place for each place of the target, by those of the first few places (f,)."""
    few, every = np.arange(len(placed)), np.arange(len(unlike))
    return _by_landmarks(every, few, placed, LANDMARK_MAPS.later_unlikeness * unlike, target, source)


def _by_landmarks(
    places: Integers,
    landmarks: Integers,
    placed: Integers,
    unlike: Floats,
    target: IncompleteShape,
    source: IncompleteShape,
) -> Integers:
    """(p,) the source's place for some places (p,) of the target, which are unlike (p, d_s) those of the source."""
    here = target.between[np.ix_(places, landmarks)].astype(np.float32)
    there = source.between[placed].astype(np.float32)
    tolerance = LANDMARK_MAPS.tolerance + LANDMARK_MAPS.relative_tolerance * here
    most, weight = LANDMARK_MAPS.max_cost * tolerance, 1 / (len(landmarks) * tolerance)
    cost = unlike.astype(np.float32)
    for start in range(0, len(places), BLOCK):
        block = slice(start, start + BLOCK)
        difference = there - here[block, :, None]
        np.abs(difference, out=difference)
        np.minimum(difference, most[block, :, None], out=difference)
        cost[block] += (weight[block, None] @ difference)[:, 0]
    return np.asarray(np.argmin(cost, axis=1))
