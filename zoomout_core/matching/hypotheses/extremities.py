# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses from extremities: hands, feet, head, tail, matched by their distances along the surface.

Extremities are the persistent maxima of the average geodesic distance. Pairings of two shapes' extremities are compared
by the preservation of the distances between them. Many are tried, because a mirror image preserves them equally, and a
limb that only one shape has favours wrong ones. The distances to the paired extremities, and their handedness around
each point, give a map by nearest neighbours. The invariants of this map decide which pairings are refined, with the
extremities as constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice, zip_longest

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.anchors import Anchors
from zoomout_core.maps.nearest import nearest
from zoomout_core.matching.hypotheses.hypothesis import HYPOTHESES, Hypothesis, alike
from zoomout_core.matching.hypotheses.landmarks import anchored_hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.landmark_features import LandmarkFeatures, landmark_features
from zoomout_core.matching.ranking.scores import Disagreement, no_disagreement, scores_of, total_score
from zoomout_core.matching.refinement.local_rigid_alignment import sides_are_known
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.once import once_per_argument
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ExtremityTuning(Tuning, set_by="correspondence"):
    """The definition of extremities, and the pairings that are tried."""

    # Minimum rise of the average distance above the pass to a higher maximum: heads have at least 0.14, hands and feet
    # 0.34, fingers 0.05.
    persistence: float = tuned(0.09, "at unit area", 0, 2)
    min_count: int = tuned(3, "extremities", 2, 30)  # minimum number of extremities for pairing
    max_count: int = tuned(12, "extremities", 2, 30)  # maximum number of extremities of a shape
    # Numbers of pairings to try that pair all extremities, all but one, all but two and all but three. If only one
    # shape has a limb, the right pairing is one of many.
    quotas: tuple[int, ...] = tuned((60, 30, 15, 8), "pairings", 0, 10_000)
    average_cost: float = tuned(0.5, "1", 0, 100)  # of differences of average distances, against those of pairs
    persistence_cost: float = tuned(0.5, "1", 0, 100)  # cost of a difference of persistence
    levels: int = tuned(2, "levels", 0, 30)  # of persistence at which the leading tips are also paired alone
    kept_consistent: int = tuned(8, "pairings", 0, 1000)  # pairings to refine that preserve distances best
    # Total number of pairings to refine; the others have the best scores of their first maps.
    kept: int = tuned(16, "pairings", 1, 1000)
    lesser_persistence: float = tuned(0.05, "at unit area", 0, 2)  # of further tips, such as ears
    more_consistent: int = tuned(20, "pairings", 0, 1000)  # of these pairings, those that preserve distances best
    more: int = tuned(40, "pairings", 1, 1000)  # total number of these pairings to refine
    coarse_size: int = tuned(20, "eigenfunctions", 2, 1000)  # size of the functional maps of the first maps
    # Entries of the table of extensions that the search for pairings keeps. With up to seven extremities on either side
    # no pairing is lost.
    beam: int = tuned(1 << 18, "entries", 1 << 12, 1 << 30)


EXTREMITIES = ExtremityTuning()


@dataclass(frozen=True, eq=False)
class Extremities:
    """The tips of a shape."""

    places: LandmarkFeatures  # the tips' vertices, the most persistent first, and their functions
    average_distance: Floats  # (m,) to all of the surface, at unit area
    persistence: Floats  # (m,) persistence of each

    @property
    def vertices(self) -> Integers:
        """(m,) of the mesh, the most persistent first."""
        return self.places.vertices

    @property
    def between(self) -> Floats:
        """(m, m) geodesic distances between the tips."""
        distances = self.places.distances[self.vertices]
        return (distances + distances.T) / 2

    def leading(self, count: int) -> Extremities:
        """The most persistent ones alone."""
        places = LandmarkFeatures(
            self.places.vertices[:count], self.places.distances[:, :count], self.places.turns[:, :count, :count]
        )
        return Extremities(places, self.average_distance[:count], self.persistence[:count])


def extremity_hypotheses(
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    disagreement: Disagreement = no_disagreement,  # with the known evidence
    # 1 for maps that keep the orientation, -1 for those that reverse it. Those that keep it, when not given, and where
    # sides are not known the others too.
    sides: tuple[int, ...] | None = None,
    # Which pairings are tried, by the numbers of tips in each shape, in parallel.
    wanted: Callable[[Integers, Integers], bool] = lambda of_target, of_source: True,
) -> list[Hypothesis]:
    """The maps that pairings of extremities suggest; none where a shape has too few of them."""
    sides = _sides(source, target) if sides is None else sides
    quotas = EXTREMITIES.kept_consistent, EXTREMITIES.kept
    return _best_maps(source, target, extremities, quotas, disagreement, sides, wanted)


def more_extremity_hypotheses(
    source: ShapeAnalysis, target: ShapeAnalysis, disagreement: Disagreement = no_disagreement
) -> list[Hypothesis]:
    """Further maps if no map is likely: from more pairings, and from pairings of tips of lower persistence.

    Other species have limbs, ears and snouts of other lengths. The right pairing may then not be among those that
    preserve distances best, or one of its tips may not be an extremity.
    """
    sides, lesser = _sides(source, target), partial(_extremities, least=EXTREMITIES.lesser_persistence)
    usual = EXTREMITIES.kept_consistent, EXTREMITIES.kept
    more = EXTREMITIES.more_consistent, EXTREMITIES.more
    return [
        *_best_maps(source, target, extremities, more, disagreement, sides),
        *_best_maps(source, target, lesser, usual, disagreement, sides),
    ]


def _sides(source: ShapeAnalysis, target: ShapeAnalysis) -> tuple[int, ...]:
    """1 for maps that keep the orientation, and -1 for those that reverse it where sides are not known."""
    return (1,) if sides_are_known(source, target) else (1, -1)


def _best_maps(
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    tips_of: Callable[[ShapeAnalysis], Extremities],
    quotas: tuple[int, int],  # maps to keep by the preservation of distances, and in all; the others by score
    disagreement: Disagreement,
    sides: tuple[int, ...],
    wanted: Callable[[Integers, Integers], bool] = lambda of_target, of_source: True,
) -> list[Hypothesis]:
    """For each of some sides, the distinct maps of pairings that are closest to isometries."""
    tips_source, tips_target = tips_of(source), tips_of(target)
    found = [pairing for pairing in _all_pairings(tips_target, tips_source) if wanted(*pairing)]
    at_source, at_target = tips_source.places.at(source.search.samples), tips_target.places.at(target.search.samples)
    size = min(EXTREMITIES.coarse_size, source.search.rows.shape[1], target.search.rows.shape[1])
    hypotheses = []
    for side in sides if found else ():
        scores, places = [], []
        features: dict[bytes, Floats] = {}  # of the target's tips: many pairings have the same
        for of_target, of_source in found:
            if (tips := of_target.tobytes()) not in features:
                features[tips] = at_target.features(of_target, side)
            sample_map = nearest(features[tips], at_source.features(of_source))
            functional_map = target.search.fit(source.search.rows[sample_map, :size], size)
            evidence = disagreement(functional_map, sample_map, None)
            scores.append(total_score(scores_of(functional_map, sample_map, source, target, side < 0) | evidence))
            places.append(source.coordinates[sample_map])
        kept = _select(np.array(scores), alike(places, HYPOTHESES.same_map), [len(pairs) for pairs, _ in found], quotas)
        for of_target, of_source in (found[i] for i in kept):
            pairs = " ".join(f"{t}-{s}" for t, s in zip(of_target, of_source, strict=True))
            origin = f"extremities {pairs}" + ", mirrored" * (side < 0)
            anchors = Anchors(tips_source.places.features(of_source), tips_target.places.features(of_target, side))
            hypotheses.append(anchored_hypothesis(origin, source, target, anchors))
    return hypotheses


def _select(scores: Floats, same: Booleans, pairs: Sequence[int], quotas: tuple[int, int]) -> list[int]:
    """Numbers of distinct maps to keep, up to the first quota in their order, and up to the second one by score.

    Args:
        scores: (m,) of maps; the lowest is the best.
        same: (m, m) which maps are alike.
        pairs: (m,) number of pairs of tips that support each.
        quotas: numbers of maps after each choice.
    """
    by_score = np.argsort(scores, kind="stable")
    by_pairs = sorted(by_score, key=lambda i: -pairs[i])
    kept: list[int] = []
    for quota, by_merit in zip(quotas, (np.arange(len(scores)), by_score), strict=True):
        for i in by_merit:
            if len(kept) < quota and not same[i, kept].any():
                # Among similar maps, keep the one that most pairs support, whatever their order.
                kept.append(int(by_pairs[np.argmax(same[i, by_pairs])]))
    return kept


@once_per_argument
def extremities(shape: ShapeAnalysis) -> Extremities:
    """Persistent maxima of the average geodesic distance, within the limits of `ExtremityTuning`."""
    return _extremities(shape, EXTREMITIES.persistence)


def _extremities(shape: ShapeAnalysis, least: float) -> Extremities:
    average = _average_distance(shape)
    vertices, persistence = maxima(shape)
    count = int(np.clip((persistence > least).sum(), EXTREMITIES.min_count, EXTREMITIES.max_count))
    vertices, persistence = vertices[:count], persistence[:count]
    return Extremities(landmark_features(shape, vertices), average[vertices], persistence)


def has_extremities(shape: ShapeAnalysis) -> bool:
    """Whether enough tips have a high persistence."""
    _, persistence = maxima(shape)
    return int((persistence > EXTREMITIES.persistence).sum()) >= EXTREMITIES.min_count


@once_per_argument
def maxima(shape: ShapeAnalysis) -> tuple[Integers, Floats]:
    """(e,) vertices where the average distance is largest nearby, and (e,) their persistence, in falling order."""
    return _persistent_maxima(_average_distance(shape), shape.mesh)


@once_per_argument
def _average_distance(shape: ShapeAnalysis) -> Floats:
    """(n,) geodesic distance to all of the surface."""
    mass = np.bincount(shape.voronoi_cell, shape.basis.areas, minlength=len(shape.distances))
    return np.asarray(mass @ shape.distances)


def _all_pairings(first: Extremities, second: Extremities) -> list[tuple[Integers, Integers]]:
    """Pairings of all extremities, and of the leading ones alone, ordered by the preservation of distances.

    None if a shape has too few of them.
    """
    if min(len(first.vertices), len(second.vertices)) < EXTREMITIES.min_count:
        return []
    counts = _levels(first.persistence, second.persistence)
    found = [pairings(first, second), *(pairings(first.leading(count), second.leading(count)) for count in counts)]
    # In turns, so that the most consistent ones of each come first.
    return [pairing for turn in zip_longest(*found) for pairing in turn if pairing is not None]


def _levels(first: Floats, second: Floats) -> list[int]:
    """Numbers of leading tips after which the persistence of both shapes drops: these may correspond one to one.

    Claws, ears and horns come and go with pose and proportions; limbs do not.
    """
    counts = np.arange(EXTREMITIES.min_count, min(len(first), len(second)))
    drop = np.minimum(first[counts - 1] / first[counts], second[counts - 1] / second[counts])
    best = counts[np.argsort(-drop, kind="stable")][: EXTREMITIES.levels]
    return [int(count) for count in best]


def pairings(first: Extremities, second: Extremities) -> list[tuple[Integers, Integers]]:
    """The most consistent pairings of two shapes' extremities, the best first: numbers in each, in parallel."""
    units = first.average_distance.mean(), second.average_distance.mean()
    distances, average, persistence = (
        (getattr(first, name) / units[0], getattr(second, name) / units[1])
        for name in ("between", "average_distance", "persistence")
    )
    single = EXTREMITIES.average_cost * np.abs(average[0][:, None] - average[1])
    single += EXTREMITIES.persistence_cost * np.abs(persistence[0][:, None] - persistence[1])
    mutual = np.abs(distances[0][:, None, :, None] - distances[1][None, :, None, :])
    full = min(single.shape)
    kept: list[tuple[Integers, Integers]] = []
    for left_out, quota in enumerate(EXTREMITIES.quotas):
        if full - left_out >= min(full, EXTREMITIES.min_count):
            kept += islice(zip(*cheapest_pairings(single, mutual, full - left_out), strict=True), quota)
    return kept


def cheapest_pairings(single: Floats, mutual: Floats, size: int) -> tuple[Integers, Integers]:
    """Pairings of some elements of two sets, by rising cost; a beam search, exact where the sets are small.

    The cost of `size` pairs is the mean of their costs `single` (a, b), plus the mean of `mutual` (a, b, a, b) over all
    two of them. Returns (p, size) elements of the first set, in rising order, and (p, size) their partners.
    """
    a, b = single.shape
    width = EXTREMITIES.beam // (a * b)
    twos = max(size * (size - 1) // 2, 1)
    left = right = np.empty((1, 0), dtype=np.int64)
    total, extension = np.zeros(1), single[None] / size  # the cost that each further pair would add to each pairing
    for depth in range(size):
        room = a - (size - depth) + 1  # leaves elements of the first set for the pairs to come
        cost = (total[:, None, None] + extension[:, :room]).ravel()
        count = min(width, int(np.isfinite(cost).sum()))
        best = np.argpartition(cost, count - 1)[:count]
        pairing, i, j = np.unravel_index(best, (len(total), room, b))
        left, right = np.column_stack([left[pairing], i]), np.column_stack([right[pairing], j])
        total, extension = cost[best], extension[pairing] + mutual[i, j] / twos
        extension[np.arange(a) <= i[:, None]] = np.inf
        extension[np.arange(count), :, j] = np.inf
    order = np.argsort(total, kind="stable")
    return left[order], right[order]


def _persistent_maxima(values: Floats, mesh: WorkingMesh) -> tuple[Integers, Floats]:
    """Local maxima of a function on the mesh and their persistence, by falling persistence.

    Every vertex belongs to the hill that its steepest ascent leads to. The lower of two hills ends at the highest pass
    between them (Edelsbrunner, Letscher and Zomorodian 2002).
    """
    order = np.argsort(-values, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    ends, _ = unique_edges(mesh.triangles)
    low, high = np.sort(rank[ends], axis=1).T[::-1]  # ranks: the lower a place, the larger its rank
    above = np.arange(len(order))
    np.minimum.at(above, low, high)
    while (above != above[above]).any():
        above = above[above]
    passes = np.flatnonzero(above[low] != above[high])
    passes = passes[np.argsort(low[passes], kind="stable")]
    joined = np.arange(len(order))  # union-find of the tops, by rank: a link to a higher one
    height = values[order]
    tops = np.unique(above)
    persistence = height[tops] - height[-1]
    for top_a, top_b, saddle in zip(above[low[passes]], above[high[passes]], low[passes], strict=True):
        a, b = _root(joined, top_a), _root(joined, top_b)
        if a != b:
            joined[max(a, b)] = min(a, b)
            persistence[np.searchsorted(tops, max(a, b))] = height[max(a, b)] - height[saddle]
    falling = np.argsort(-persistence, kind="stable")
    return order[tops[falling]], persistence[falling]


def _root(links: Integers, entry: int) -> int:
    while links[entry] != entry:
        entry = links[entry]
    return entry
