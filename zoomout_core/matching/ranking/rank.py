# SPDX-License-Identifier: GPL-3.0-or-later
"""Refine hypotheses, and rank the maps by their scores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, TypeVar

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.anchors import Anchors
from zoomout_core.maps.upsample import nearest_samples, upsample
from zoomout_core.matching.hypotheses.hypothesis import HYPOTHESES, Hypothesis, alike
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import sort_by_certainty
from zoomout_core.matching.ranking.scores import (
    Disagreement,
    fit_in_space,
    no_disagreement,
    orientation_agreement,
    scores_of,
    total_score,
)
from zoomout_core.matching.refinement.local_rigid_alignment import sides_are_known
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned

# Minimum and maximum number of maps to compare.
Quota: TypeAlias = tuple[int, int]


@dataclass(frozen=True)
class RankingTuning(Tuning, set_by="correspondence"):
    """Which hypotheses to refine, and to which size."""

    screening_size: int = tuned(30, "eigenfunctions", 4, 1000)  # size of the functional maps in the first comparison
    screening_step: int = tuned(2, "eigenfunctions", 1, 100)  # their growth in an iteration
    size: int = tuned(60, "eigenfunctions", 4, 1000)  # size of the functional maps in the comparison of the best ones
    step: int = tuned(5, "eigenfunctions", 1, 100)  # their growth in an iteration
    reverse_start: int = tuned(16, "eigenfunctions", 2, 1000)  # initial size in the other direction
    reverse_step: int = tuned(4, "eigenfunctions", 1, 100)  # its growth in an iteration
    # Distinct maps whose scores exceed the best one by less than this are compared and aligned in space, within the
    # quotas.
    margin: float = tuned(1.5, "1", 0, 100)
    direct: Quota = tuned((4, 14), "candidates", 1, 1000)  # fewest and most that keep the orientation
    mirrored: Quota = tuned((2, 4), "candidates", 0, 1000)  # fewest and most mirror images
    # A map whose normals disagree with the target's by more than this is a mirror image. If agreement and disagreement
    # balance, the map mirrors only some limbs, which alignment in space corrects.
    clear_orientation: float = tuned(0.2, "1", 0, 1)
    mirror_penalty: float = tuned(0.5, "1", 0, 100)  # of a cloth's mirror image, which a plane fits as well


RANKING = RankingTuning()


@dataclass(frozen=True, eq=False)
class _Screened:
    hypothesis: Hypothesis
    functional_map: Floats
    sample_map: Integers
    reverses_orientation: bool
    score: float


_Map = TypeVar("_Map", _Screened, Candidate)


def rank(
    hypotheses: list[Hypothesis],
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    disagreement: Disagreement = no_disagreement,
    # Numbers of maps to compare that keep the orientation, and that reverse it; tuned numbers by default.
    quotas: tuple[Quota, Quota] | None = None,
    # Disagreement of normals above which a map is a mirror image; the tuned number by default.
    clear_orientation: float | None = None,
    # Whether to compare a map, by (s_t,) the number of the source sample of each search sample, and whether it reverses
    # the orientation.
    wanted: Callable[[Integers, bool], bool] = lambda _map, _reverses: True,
    # Called with the maps (s_t,) of the hypotheses that are left after the first comparison, the most likely first.
    show: Callable[[Sequence[Integers]], object] = lambda _maps: None,
) -> list[Candidate]:
    """Refine hypotheses, drop duplicates and poor ones, and score the rest both ways; mirror images come last."""
    shapes = source, target
    clear = RANKING.clear_orientation if clear_orientation is None else clear_orientation
    quotas = (RANKING.direct, RANKING.mirrored) if quotas is None else quotas
    if not sides_are_known(*shapes):
        quotas = quotas[0], quotas[0]
    with portion(0.0, 0.6):
        screened = for_each(lambda hypothesis: _screen(hypothesis, *shapes, disagreement, clear), hypotheses)
    screened = [entry for entry in screened if wanted(entry.sample_map, entry.reverses_orientation)]
    kept = _leading(screened, [entry.score for entry in screened], source, quotas)
    show([entry.sample_map for entry in kept])
    with portion(0.6, 0.8):
        refined = for_each(lambda entry: _candidate(entry, *shapes, disagreement), kept)
    refined = [entry for entry in refined if wanted(entry.sample_map, entry.reverses_orientation)]
    leading = _leading(refined, [candidate.scores["total"] for candidate in refined], source, quotas)
    with portion(0.8, 1.0):
        candidates = for_each(lambda candidate: _align(candidate, *shapes), leading)
    return sort_by_certainty(candidates, source, target)


def with_others(
    candidates: Sequence[Candidate], others: Sequence[Candidate], source: ShapeAnalysis, target: ShapeAnalysis
) -> list[Candidate]:
    """Merge candidates with those of others that are different maps; the most likely first, with their certainty."""
    places = [source.coordinates[candidate.sample_map] for candidate in (*candidates, *others)]
    known = alike(places, HYPOTHESES.same_map)[len(candidates) :, : len(candidates)].any(axis=1)
    new = [other for other, is_known in zip(others, known, strict=True) if not is_known]
    return sort_by_certainty([*candidates, *new], source, target)


def _align(candidate: Candidate, source: ShapeAnalysis, target: ShapeAnalysis) -> Candidate:
    """Add the scores of a candidate's fit in space; if the sides are unknown, choose whether it is mirrored."""
    either = [candidate]
    if not sides_are_known(source, target):
        either.append(replace(candidate, mirrored=not candidate.mirrored))
    scored = []
    for one in either:
        scores = one.scores | fit_in_space(one.sample_map, one.anchors, one.mirrored, source, target)
        penalty = RANKING.mirror_penalty * (one.mirrored and len(either) > 1)
        scored.append(replace(one, scores=scores | {"total": total_score(scores) + penalty}))
    return min(scored, key=lambda one: one.scores["total"])


def _anchors_at_samples(hypothesis: Hypothesis, source: ShapeAnalysis, target: ShapeAnalysis) -> Anchors | None:
    anchors = hypothesis.anchors
    return None if anchors is None else anchors.at(source.search.samples, target.search.samples)


def upsample_hypothesis(
    hypothesis: Hypothesis, source: ShapeAnalysis, target: ShapeAnalysis
) -> tuple[Floats, Integers]:
    """A hypothesis at the size of the first comparison: its functional map, and (s_t,) numbers of source samples."""
    size = min(RANKING.screening_size, source.search.rows.shape[1], target.search.rows.shape[1])
    anchors = _anchors_at_samples(hypothesis, source, target)
    step = RANKING.screening_step
    return upsample(source.search, target.search, hypothesis.functional_map, size, step, anchors)


def _screen(
    hypothesis: Hypothesis,
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    disagreement: Disagreement,
    clear_orientation: float,
) -> _Screened:
    functional_map, sample_map = upsample_hypothesis(hypothesis, source, target)
    reverses = orientation_agreement(sample_map, source, target) < -clear_orientation
    scores = scores_of(functional_map, sample_map, source, target, reverses)
    scores |= disagreement(functional_map, sample_map, hypothesis.anchors)
    return _Screened(hypothesis, functional_map, sample_map, reverses, total_score(scores))


def _leading(
    maps: Sequence[_Map], scores: Sequence[float], source: ShapeAnalysis, quotas: tuple[Quota, Quota]
) -> list[_Map]:
    """The best distinct direct maps, and the best distinct mirror images."""
    if not maps:
        return []
    order = np.argsort(scores, kind="stable")
    same = alike([source.coordinates[entry.sample_map] for entry in maps], HYPOTHESES.same_map)
    leading: list[_Map] = []
    for reverses, (fewest, most) in zip((False, True), quotas, strict=True):
        oriented = [i for i in order if maps[i].reverses_orientation == reverses]
        kept: list[int] = []
        for i in oriented:
            behind = scores[i] - scores[oriented[0]]
            if len(kept) < (most if behind < RANKING.margin else fewest) and not same[i, kept].any():
                kept.append(i)
        leading += [maps[i] for i in kept]
    return leading


def _candidate(entry: _Screened, source: ShapeAnalysis, target: ShapeAnalysis, disagreement: Disagreement) -> Candidate:
    """Refine further, compute the reverse map independently, and average the scores of both."""
    size = min(RANKING.size, source.search.rows.shape[1], target.search.rows.shape[1])
    hypothesis, reverses = entry.hypothesis, entry.reverses_orientation
    anchors = _anchors_at_samples(hypothesis, source, target)
    swapped = None if anchors is None else anchors.swap()
    step = RANKING.step
    functional_map, sample_map = upsample(source.search, target.search, entry.functional_map, size, step, anchors)
    # The reverse map starts from the transpose, which is the inverse of an isometry's functional map.
    back = nearest_samples(target.search, source.search, entry.functional_map.T, swapped)
    start = min(RANKING.reverse_start, size)
    reverse = source.search.fit(target.search.rows[back, :start], start)
    reverse, reverse_map = upsample(target.search, source.search, reverse, size, RANKING.reverse_step, swapped)
    there = scores_of(functional_map, sample_map, source, target, reverses)
    back_again = scores_of(reverse, reverse_map, target, source, reverses)
    scores = {name: (there[name] + back_again[name]) / 2 for name in there}
    scores |= disagreement(functional_map, sample_map, hypothesis.anchors)
    scores["total"] = total_score(scores)
    return Candidate(
        origin=hypothesis.origin,
        reverses_orientation=reverses,
        mirrored=reverses,
        functional_map=functional_map,
        reverse_functional_map=reverse,
        sample_map=sample_map,
        anchors=hypothesis.anchors,
        final_anchors=hypothesis.final_anchors,
        certainty=0.0,
        scores=scores,
    )
