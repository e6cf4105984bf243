"""From landmarks on a shape that may lack pieces to a map of samples, and by slanted ZoomOut to a functional map.

A part has fewer eigenfunctions below a frequency than the whole, in proportion to its area (Rodola et al., Partial
functional correspondence, 2017): its side of the functional map grows more slowly. What eigenfunctions of a part and of
the whole have in common is little, so that distances to landmarks, which cuts hardly change, hold the map in place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.nearest import nearest
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class SlantedTuning(Tuning, set_by="partial"):
    """How landmarks become maps; lengths are those of the larger shape at unit area.

    Attributes:
        tolerance: of a difference of distances to a landmark.
        relative_tolerance: of that, for each unit of the distance.
        most: cost of a difference, in tolerances.
        unlikeness: weight of the unlikeness of places beside the mean cost of differences, by the first landmarks,
        later_unlikeness: and by those of the rounds that follow.
        rounds: in which places that are mapped are landmarks of the others.
        landmarks: of these rounds.
        sizes: of the functional map on the side of the shape with more functions: first, last and step.
        fewest: functions on the other side.
        anchors: places, the distances to which hold the map.
    """

    tolerance: float = tuned(0.05, "length", 1e-6, 10)
    relative_tolerance: float = tuned(0.3, "1", 0, 10)
    most: float = tuned(1.5, "tolerances", 0.1, 100)
    unlikeness: float = tuned(0.3, "1", 0, 10)
    later_unlikeness: float = tuned(0.15, "1", 0, 10)
    rounds: int = tuned(3, "rounds", 0, 100)
    landmarks: int = tuned(40, "places", 3, 1000)
    sizes: tuple[int, int, int] = tuned((12, 120, 4), "eigenfunctions", 1, 1000)
    fewest: int = tuned(4, "eigenfunctions", 1, 1000)
    anchors: int = tuned(12, "places", 3, 1000)


SLANTED = SlantedTuning()


def extended(
    landmarks: Integers, placed: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape
) -> Integers:
    """(d_t,) the place of the source for each place of the target, by distances to landmarks.

    Args:
        landmarks: (m,) places of the target.
        placed: (m,) places of the source that they correspond to.
        unlike: (d_t, d_s) `unlikeness` of the two shapes.
        target: the shape that the map starts from.
        source: the shape that it lands on.
    """
    place = _by_landmarks(landmarks, placed, SLANTED.unlikeness * unlike, target, source)
    few = np.arange(min(SLANTED.landmarks, len(place)))
    for _ in range(SLANTED.rounds):
        place = _by_landmarks(few, place[few], SLANTED.later_unlikeness * unlike, target, source)
    return place


def _by_landmarks(
    landmarks: Integers, placed: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape
) -> Integers:
    here, there = target.between[landmarks].astype(np.float32), source.between[placed].astype(np.float32)
    tolerance = len(landmarks) * (SLANTED.tolerance + SLANTED.relative_tolerance * here)
    cost = unlike.astype(np.float32)
    most = SLANTED.most / len(landmarks)
    for from_here, from_there, allowed in zip(here, there, tolerance, strict=True):
        cost += np.minimum(np.abs(from_here[:, None] - from_there) / allowed[:, None], most)
    return np.asarray(np.argmin(cost, axis=1))


def slanted_sizes(target: IncompleteShape, source: IncompleteShape) -> list[tuple[int, int]]:
    """(k_target, k_source) of each iteration: as many functions of each shape as lie below a common frequency."""
    first, last, step = SLANTED.sizes
    values = target.shape.basis.eigenvalues, source.shape.basis.eigenvalues
    most = int(np.argmin([each[min(last, len(each)) - 1] for each in values]))  # of it there are more below
    sizes = []
    for k in range(first, min(last, len(values[most])) + 1, step):
        below = int(np.searchsorted(values[1 - most], values[most][k - 1], side="right"))
        other = int(np.clip(below, SLANTED.fewest, len(values[1 - most])))
        sizes.append((other, k) if most else (k, other))
    return sizes


def slanted_map(place: Integers, target: IncompleteShape, source: IncompleteShape) -> Integers:
    """(s_t,) for each search sample of the target the number of its source sample, by ZoomOut of slanted sizes.

    Args:
        place: (d_t,) the place of the source for each place of the target.
        target: the shape that the map starts from.
        source: the shape that it lands on.
    """
    here, there = target.shape, source.shape
    anchors = np.arange(min(SLANTED.anchors, len(place)))
    on_target = here.distances[anchors][:, here.search.samples].T
    on_source = there.distances[place[anchors]][:, there.search.samples].T
    match = place[here.nearest_distance_sample]
    for k_target, k_source in slanted_sizes(target, source):
        functional_map = here.search.fit(there.search.rows[match, :k_source], k_target)
        # A step d changes the first k eigenfunctions, on average, by d times the root of half their eigenvalues' sum.
        weight = np.sqrt(there.basis.eigenvalues[:k_source].sum() * k_target / k_source / 2 / len(anchors))
        queries = np.hstack([here.search.rows[:, :k_target], weight * on_target])
        embedded = np.hstack([there.search.rows[:, :k_source] @ functional_map.T, weight * on_source])
        match = nearest(queries, embedded)
    return match
