# SPDX-License-Identifier: GPL-3.0-or-later
"""Beam search for a few landmarks of one shape on another one that may lack pieces.

The landmarks of a part are far from its cuts and from each other. They are assigned one after another to places of the
other shape that preserve the distances between them and the areas around them. Each step keeps the best assignments.
These include mirrored ones, which the fit of normals rejects later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers, SingleFloats
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class LandmarkSearchTuning(Tuning, set_by="partial"):
    """The landmarks, and the costs of assignments; lengths are those of the larger shape at unit area."""

    # In the choice of the first landmark, a tip: weight of the mean distance to all places, relative to the distance to
    # a cut.
    mean_distance: float = tuned(0.3, "1", 0, 10)
    near_cut: float = tuned(0.1, "1", 1e-6, 10)  # sufficient distance to a cut, over the root of the area
    min_weight: float = tuned(0.3, "1", 0, 1)  # weight of a place on a cut, in the choice of the others
    region: float = tuned(0.45, "1", 0.01, 1)  # share of places from which landmarks around one are chosen
    places: int = tuned(200, "places", 10, 10_000)  # number of places of the source on which landmarks may be placed
    width: int = tuned(500, "assignments", 1, 100_000)  # width of the beam
    cells: int = tuned(80, "cells", 1, 1000)  # of the source; the best of all assignments to the same cells is kept
    tolerance: float = tuned(0.06, "length", 1e-6, 10)  # tolerance of a difference of distances
    relative_tolerance: float = tuned(0.15, "1", 0, 10)  # additional tolerance for each unit of the distance
    doubt: float = tuned(0.6, "1", 0, 1)  # weight of a difference that a cut may explain
    distances: float = tuned(2.0, "1", 0, 100)  # weight of the differences of distances against unlikeness
    # Number of distinct assignments to keep. Costs are too coarse to order them: with 16 kept, scaling a part by 3 %
    # loses or finds its right map. Of 4 lost parts of people and cats, 3 are found with 48, and no more with 128.
    kept: int = tuned(48, "assignments", 1, 1000)
    apart: float = tuned(0.1, "length", 0, 10)  # minimum mean distance between the places of distinct assignments


SEARCH = LandmarkSearchTuning()


def landmarks_of(target: IncompleteShape, count: int, around: int | None = None) -> Integers:
    """(m,) places of a shape, `count` at most: a tip far from cuts, and farthest places, those near cuts later.

    The first landmark may be given as `around`; then the others are among the places near it.
    """
    between, cut_distance = target.between, target.cut_distance
    scale = SEARCH.near_cut * np.sqrt(target.shape.basis.areas.sum())
    weight = np.clip(cut_distance / scale, SEARCH.min_weight, 1)
    if around is None:
        remote = np.where(np.isfinite(cut_distance), cut_distance, 0)
        chosen = [int(np.argmax(remote + SEARCH.mean_distance * between.mean(axis=1)))]
    else:
        chosen = [around]
        weight = np.where(between[around] <= np.quantile(between[around], SEARCH.region), weight, 0)
    while len(chosen) < min(count, int(np.count_nonzero(weight))):
        chosen.append(int(np.argmax(between[chosen].min(axis=0) * weight)))
    return np.array(chosen)


def assignments(landmarks: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape) -> Integers:
    """(a, m) the best assignments of landmarks (m,) of the target to places of the source, by rising cost."""
    count = min(SEARCH.places, len(source.between))
    cell = np.argmin(source.between[: SEARCH.cells, :count], axis=0)
    unlike = unlike[:, :count].astype(np.float32)
    placed = np.empty((1, 0), dtype=np.int64)
    single, mutual = np.zeros((2, 1), dtype=np.float32)
    for step, landmark in enumerate(landmarks):
        singles, mutuals = single[:, None] + unlike[landmark], np.tile(mutual[:, None], count)
        for earlier in range(step):
            mutuals += _cost_of_pair(landmark, landmarks[earlier], target, source, count)[placed[:, earlier]]
        pairs = max(step * (step + 1) // 2, 1)
        total = singles / np.float32(step + 1) + np.float32(SEARCH.distances / pairs) * mutuals
        entry, place = _best(total, placed, cell)
        placed = np.column_stack([placed[entry], place])
        single, mutual = singles[entry, place], mutuals[entry, place]
    return placed


def distinct(placed: Integers, source: IncompleteShape) -> list[int]:
    """The numbers of the first assignments (a, m) that differ from those before them."""
    kept: list[int] = []
    differs = np.ones(len(placed), dtype=bool)
    while differs.any() and len(kept) < SEARCH.kept:
        kept.append(int(np.argmax(differs)))
        differs &= source.between[placed, placed[kept[-1]]].mean(axis=1) > SEARCH.apart
    return kept


def _cost_of_pair(one: int, other: int, target: IncompleteShape, source: IncompleteShape, count: int) -> SingleFloats:
    """(p, p) costs of placing the second and the first landmark on each pair of places, in [0, 1]."""
    distance, among = target.between[one, other], source.between[:count, :count]
    difference = np.abs(among - distance)
    # A cut makes paths longer, never shorter.
    in_doubt = np.where(among < distance, not target.unaffected[one, other], ~source.unaffected[:count, :count])
    difference[in_doubt] *= SEARCH.doubt
    return np.asarray(
        np.minimum(difference / (SEARCH.tolerance + SEARCH.relative_tolerance * distance), 1), dtype=np.float32
    )


def _best(total: Floats, placed: Integers, cell: Integers) -> tuple[Integers, Integers]:
    """The best extensions of assignments, by rising cost: numbers of assignments, and the places added to them.

    Of those that agree in the cells of all landmarks the best one is kept, from the third landmark on.
    """
    tried = min(12 * SEARCH.width, total.size)
    best = np.argpartition(total, tried - 1, axis=None)[:tried]
    best = best[np.argsort(total.ravel()[best], kind="stable")]
    entry, place = np.unravel_index(best, total.shape)
    if placed.shape[1] >= 2:
        cells = np.column_stack([cell[placed[entry]], cell[place]])
        # One number for each row sorts ten times as fast; random factors make two rows agree once in 2^64 times.
        factors = np.random.default_rng(0).integers(1 << 62, size=cells.shape[1])
        first = np.sort(np.unique(cells @ factors, return_index=True)[1])
        entry, place = entry[first], place[first]
    return entry[: SEARCH.width], place[: SEARCH.width]
