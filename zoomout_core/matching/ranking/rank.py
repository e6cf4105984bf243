# SPDX-License-Identifier: GPL-3.0-or-later
"""Refine hypotheses, rank the maps by their scores, and compute the certainty of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, TypeVar

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.anchors import Anchors
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.maps.zoomout import nearest_samples, upsample
from zoomout_core.matching.hypotheses.hypothesis import HYPOTHESES, Hypothesis, alike
from zoomout_core.matching.partial.part_candidates import PartCandidate
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.scores import (
    ENERGY,
    SCORES,
    TORN,
    Disagreement,
    fit_in_space,
    no_disagreement,
    orientation_agreement,
    scores_of,
    total_score,
)
from zoomout_core.matching.refinement.local_rigid_alignment import sides_are_known
from zoomout_core.mesh.triangles import border_edges
from zoomout_core.messages import probability
from zoomout_core.runtime.once import once_per_argument
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.summary import Summary
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


@dataclass(frozen=True)
class CertaintyTuning(Tuning, set_by="correspondence"):
    """Convert scores to a probability.

    A bad fit indicates that the right map is not among the candidates. Its odds were fitted to 315 pairs of 23 kinds,
    in two poses or of two species: people, animals, gorillas and men, and game characters of one skin. The odds of
    rivals were set on 76 pairs of 15 kinds: FAUST, SHREC19, TOSCA, SMAL, gorillas and men, bodies with touching limbs,
    and game characters. 70 of these were also used without their right maps, because a search may miss them. Of the 74
    right maps, 69 are above 90 %. Of the maps that come first without them, 21 are. By energies on the whole, these are
    68 and 41. A rivalry of 2.5 to 3 is the most likely one, whichever kind is left out. With it, 64 and 19 are above 90
    %. Tears were set on 48 pairs of SMAL, gorillas and men, people and game characters: 43 right maps are above 90 %
    (44 without tears). Of 51 wrong maps, which come first without the right one or between men and animals, 10 are (18
    without tears). On 26 and 32 others (TOSCA, touching limbs, skins, builds, skulls, other species), 22 are (23), and
    7 (11).
    """

    # Distance of two images above which they are on different limbs.
    elsewhere: float = tuned(0.2, "at unit area", 0, 2)
    # Share of the target's area with such images above which two maps are rivals. Finished variants of one map have at
    # most 0.01 of it, and maps that exchange two lower legs of a cat, horse or cow 0.023 and more.
    rival: float = tuned(0.02, "1", 0, 1)
    another_map: float = tuned(0.1, "at unit area", 0, 2)  # mean distance above which two symmetries of a shape differ
    rivalry: float = tuned(4.0, "1", 0, 100)  # rate at which the odds of a rival decrease with the lead in score
    largest_lead: float = tuned(20.0, "1", 0, 100)  # lead beyond which the odds stay constant
    misfit: float = tuned(28.23, "1", -100, 100)  # log odds against a map whose mean distance in space is 1
    # Log odds in favour of closed shapes: a part can be missing only at a border. Wrong maps of parts as wholes fit as
    # well as right ones of gorillas to men, at a mean distance of 0.03. With 0.5 less, a cut cat is mapped as a whole.
    closed: float = tuned(3.23, "1", 0, 100)
    misfit_rate: float = tuned(8.25, "1", 0, 100)  # rate at which it increases with the logarithm of the distance
    # A map that exchanges limbs tears the surface between them, even if the right map is not among its rivals. Beyond
    # this number of torn triangles, the odds against a finished map of closed shapes grow with a power of it. Right
    # maps of hulls are torn where limbs touch.
    tear: float = tuned(3.0, "triangles", 1e-9, 1e6)
    tear_rate: float = tuned(1.5, "1", 0, 100)  # that power
    # Log odds by which tears count at most: right maps of shapes with few vertices are torn, too.
    tear_limit: float = tuned(3.5, "1", 0, 100)
    # Odds against all direct maps if the best mirror image leads them in score. Of 11 otherwise certain maps of bodies
    # in the opposite pose (FAUST, SCAPE, TOSCA) with a lead of at least 3, 2 are wrong. Of 64 pairs of SMAL, SHREC19,
    # gorillas and men, all right or uncertain, the largest lead is 0.34.
    image: float = tuned(0.2, "odds", 0, 100)
    image_lead: float = tuned(2.5, "1", 0, 100)  # lead at which half of these odds count
    unlikely: float = tuned(0.5, "probability", 0, 1)  # more hypotheses are tried below this certainty


CERTAINTY = CertaintyTuning()


@dataclass(frozen=True, eq=False, repr=False)
class Candidate(Summary):
    """A map between two shapes' samples, with its scores."""

    origin: str  # name of the hypothesis that it was refined from
    reverses_orientation: bool  # whether it reverses the orientation, as a mirror image does
    # Whether it maps the target's mirror image. This equals `reverses_orientation`, unless the outer side of an open
    # surface is unknown: then it may be a map onto the other side.
    mirrored: bool
    functional_map: Floats  # (k_target, k_source)
    reverse_functional_map: Floats  # (k_source, k_target), of the map found in the other direction
    sample_map: Integers  # (s_t,) for each search sample of the target the number of its source sample
    anchors: Anchors | None  # constraints of the search at all vertices
    final_anchors: Anchors | None  # constraints of the final map, if the user gave any
    certainty: float  # probability, in [0, 1], that this map is right, among the maps of the same orientation
    # Commutativity, frequency, distance, curvature, handedness (see `scores_of`), disagreements with constraints, and
    # their total; the lowest total is the most likely map.
    scores: dict[str, float]
    # The placement of one shape as a part of the other, from which the map is found by registration; None for maps of
    # two whole shapes.
    part_match: PartCandidate | None = None
    # Its map between the shapes' meshes, and the functional map (k, k) of that, if it was refined to be ranked.
    refined: tuple[SurfaceMap, Floats] | None = None
    distortion: Floats | None = None  # (n_t,) `local_distortion` of that map
    turns: int = 1  # number of maps, this one included, that differ only by rotational symmetries of one of the shapes

    def _summary(self) -> dict[str, str]:
        return {
            "origin": self.origin,
            "certainty": probability(self.certainty),
            "orientation": "reversed" if self.reverses_orientation else "kept",
            "size": " x ".join(map(str, self.functional_map.shape)),
        }


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


def sort_by_certainty(candidates: list[Candidate], source: ShapeAnalysis, target: ShapeAnalysis) -> list[Candidate]:
    """Candidates with their certainty, the most likely first.

    Mirror images come last and rival only each other, unless the sides are unknown, such as those of a cloth.
    """
    apart = sides_are_known(source, target)
    if not apart:
        return _sort_rivals(candidates, source, target)
    direct, mirrored = (
        _sort_rivals([one for one in candidates if one.mirrored == side], source, target) for side in (False, True)
    )
    return [*_doubt_by_mirror_image(direct, mirrored), *mirrored]


def _doubt_by_mirror_image(direct: Sequence[Candidate], mirrored: Sequence[Candidate]) -> list[Candidate]:
    """Direct candidates, with less certainty if the best mirror image has a much better score than the best of them.

    Then one shape is the mirror image of the other, or a body in the opposite pose, such as half a stride later. Maps
    that exchange only the arms, or only the legs, of a body in the opposite pose fit nearly as well as the right one.
    """
    if not direct or not mirrored:
        return list(direct)
    best, image = (min(one.scores["total"] for one in side) for side in (direct, mirrored))
    lead = np.clip(best - image - CERTAINTY.image_lead, -CERTAINTY.largest_lead, CERTAINTY.largest_lead)
    doubt = CERTAINTY.image / (1 + np.exp(-CERTAINTY.rivalry * lead))
    return [replace(one, certainty=float(one.certainty / (1 + doubt))) for one in direct]


@once_per_argument
def is_closed(shape: ShapeAnalysis) -> bool:
    """Whether nothing can be missing; a hull is closed whatever it is around."""
    return not shape.proxy.full.is_hull and not len(border_edges(shape.mesh.triangles))


def _sort_rivals(rivals: Sequence[Candidate], source: ShapeAnalysis, target: ShapeAnalysis) -> list[Candidate]:
    """Candidates that rival each other, with their certainty, which never rises from one to the next."""
    totals = _totals(rivals, is_closed(source) and is_closed(target))
    order = np.argsort(totals, kind="stable")
    ranked, totals = [rivals[i] for i in order], totals[order]
    certainties = [_certainty(number, ranked, totals, source, target) for number in range(len(ranked))]
    falling = np.minimum.accumulate(certainties)
    return [replace(one, certainty=float(certainty)) for one, certainty in zip(ranked, falling, strict=True)]


def _totals(candidates: Sequence[Candidate], closed: bool) -> Floats:
    """(c,) total scores with the energies of finished maps, and with their tears if the shapes are closed.

    An unknown energy, and unknown tears, count as the largest known ones.
    """
    finished = np.array([_finished_score(candidate.scores, closed) for candidate in candidates])
    known = np.isfinite(finished)
    filled = np.where(known, finished, finished[known].max()) if known.any() else np.zeros(len(finished))
    return np.asarray(filled + [candidate.scores["total"] for candidate in candidates])


def _finished_score(scores: dict[str, float], closed: bool) -> float:
    """The contribution of a finished map's energy and tears to its total score; not a number if it is not finished."""
    tears = _tear_odds(scores) / CERTAINTY.rivalry if closed else 0.0
    return float(SCORES.energy * np.log(max(scores[ENERGY], 1e-9))) + tears if ENERGY in scores else np.nan


def _tear_odds(scores: dict[str, float]) -> float:
    """Log odds against a finished map of closed shapes by the triangles that it tears."""
    tears = CERTAINTY.tear_rate * np.log1p(scores.get(TORN, 0.0) / CERTAINTY.tear)
    return float(min(tears, CERTAINTY.tear_limit))


def with_others(
    candidates: Sequence[Candidate], others: Sequence[Candidate], source: ShapeAnalysis, target: ShapeAnalysis
) -> list[Candidate]:
    """Merge candidates with those of others that are different maps; the most likely first, with their certainty."""
    places = [source.coordinates[candidate.sample_map] for candidate in (*candidates, *others)]
    known = alike(places, HYPOTHESES.same_map)[len(candidates) :, : len(candidates)].any(axis=1)
    new = [other for other, is_known in zip(others, known, strict=True) if not is_known]
    return sort_by_certainty([*candidates, *new], source, target)


def are_rivals(one: Candidate, other: Candidate, source: ShapeAnalysis, target: ShapeAnalysis) -> bool:
    """Whether two candidates map some limb to different ones, instead of being variants of one map."""
    if other is one:
        return False
    areas, apart = _differences(one, other, source, target)
    return bool(areas[apart > CERTAINTY.elsewhere].sum() > CERTAINTY.rival * areas.sum())


def _differences(
    one: Candidate, other: Candidate, source: ShapeAnalysis, target: ShapeAnalysis
) -> tuple[Floats, Floats]:
    """(p,) the area around some places of the target, and (p,) the distance of each one's images by two candidates.

    These are the mesh's vertices if both maps are finished, search samples otherwise.
    """
    if one.refined is not None and other.refined is not None:
        return target.basis.areas, source.min_distances(one.refined[0].vertex, other.refined[0].vertex)
    samples = source.search.samples
    return target.weights, source.min_distances(samples[one.sample_map], samples[other.sample_map])


def _certainty(
    number: int, ranked: Sequence[Candidate], totals: Floats, source: ShapeAnalysis, target: ShapeAnalysis
) -> float:
    """Probability that a candidate is right: its share among the maps that rival it, times that of its fit."""
    candidate = ranked[number]
    rivals = 0.0
    for other, total in zip(ranked, totals, strict=True):
        if are_rivals(candidate, other, source, target):
            lead = _lead(candidate, other, total - totals[number], source, target)
            rivals += np.exp(-CERTAINTY.rivalry * np.clip(lead, -CERTAINTY.largest_lead, CERTAINTY.largest_lead))
    doubt = _odds_against(candidate.scores, is_closed(source) and is_closed(target))
    return float(1 / (1 + rivals) / (1 + doubt))


def _odds_against(scores: dict[str, float], closed: bool) -> float:
    """Odds against a map by its fit in space, and between closed shapes by its tears."""
    log_odds = CERTAINTY.misfit + CERTAINTY.misfit_rate * np.log(max(scores["place"], 1e-9))
    if closed:
        log_odds += _tear_odds(scores) - CERTAINTY.closed
    return float(np.exp(log_odds))


def _lead(one: Candidate, other: Candidate, on_the_whole: float, source: ShapeAnalysis, target: ShapeAnalysis) -> float:
    """The lead in score of a map over a rival: if both are finished, by their energies where they differ.

    Two maps that differ in a leg have nearly the same energy on the whole. So each vertex counts by the distance
    between its two images.
    """
    here, there = one.distortion, other.distortion
    if here is None or there is None:
        return on_the_whole
    areas, apart = _differences(one, other, source, target)
    weights = areas * apart
    ratio = max(float(weights @ there), 1e-9) / max(float(weights @ here), 1e-9)
    closed = is_closed(source) and is_closed(target)
    tears = (_tear_odds(other.scores) - _tear_odds(one.scores)) / CERTAINTY.rivalry if closed else 0.0
    return other.scores["total"] - one.scores["total"] + SCORES.energy * float(np.log(ratio)) + tears


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
    maps, anchors_of_map = (functional_map, reverse, sample_map), (hypothesis.anchors, hypothesis.final_anchors)
    return Candidate(hypothesis.origin, reverses, reverses, *maps, *anchors_of_map, 0.0, scores)
