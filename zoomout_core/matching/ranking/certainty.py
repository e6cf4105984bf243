# SPDX-License-Identifier: GPL-3.0-or-later
"""The certainty of a candidate: the probability that its map is right as a whole, with no sides or limbs exchanged.

It is the probability that the map fits if it has no rivals, times its share among its rivals. Maps of two whole shapes
get it from `sort_by_certainty`, those of a part from `certainty_of_part`. Afterwards, `confirmed_certainty` raises it
if the map of another body agrees, and `certainty_of_torn` limits it if the final map is torn. `MatchResult.certainty`
is its product with the part of the area that has a known place. Symmetries have another one, in `symmetry/ranking.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from zoomout_core.arrays import Floats
from zoomout_core.matching.partial.curvature import curvature_score
from zoomout_core.matching.partial.gaps import GAPS
from zoomout_core.matching.partial.part_candidates import images_apart
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.scores import ENERGY, SCORES, TORN
from zoomout_core.matching.refinement.local_rigid_alignment import sides_are_known
from zoomout_core.matching.report.verdict import VERDICT
from zoomout_core.mesh.triangles import border_edges
from zoomout_core.runtime.once import once_per_argument
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class CertaintyTuning(Tuning, set_by="correspondence"):
    """Convert the scores of a map of two whole shapes to a probability.

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
    # Odds against all direct maps if the best mirror image leads them in score, and a rival of the first is farther
    # from it. The rival then comes first. On the 8 pairs that set this (characters at opposite strides, TOSCA horses),
    # it corrects 5 maps that exchange limbs; 2 were right, and in one, the mirror image does not lead. On 14 pairs of
    # other characters, it corrects 9 of 10 such maps, and keeps the 4 right ones.
    image: float = tuned(0.2, "odds", 0, 100)
    image_lead: float = tuned(1.0, "1", 0, 100)  # lead at which half of these odds count, and the rival comes first
    # Lag in score up to which direct maps are compared with the image. For the man who sets it, the right map lags by
    # 2.07, and one that exchanges arms by 2.36 and is farther. Other right maps lag by 0.3 to 2.
    image_rival: float = tuned(2.2, "1", 0, 100)
    # Ratio of the first map's distance from the image to the largest one, below which the rival comes first. It is at
    # least 0.96 for right maps; for wrong ones 0.14 to 0.82, and 1 if the right map is not among the candidates.
    image_apart: float = tuned(0.9, "1", 0, 1)
    # Ratio of the energies of the finished maps of the rival and of the first, up to which the rival comes first. It is
    # 1.02 to 1.15 where the rival is right (9 people at opposite strides), and 1.33 for a dog and a fox, where it is
    # wrong.
    image_energy: float = tuned(1.25, "1", 0, 100)
    unlikely: float = tuned(0.5, "probability", 0, 1)  # more hypotheses are tried below this certainty


@dataclass(frozen=True)
class PartCertaintyTuning(Tuning, set_by="partial"):
    """Convert the scores of a part to a probability; lengths are those of the larger shape at unit area.

    The certainty was fitted to 140 pairs of ten kinds: people, animals, and other species; cuts, holes, missing pieces,
    small parts, and both cut. Each pair was also used without its right maps, at a quarter of the weight, because these
    may not be found. In cross-validation over kinds, 30 of 31 maps above 90 % were right, and the other one was off by
    0.09 on average; of 97 pairs without their right maps, 2 were above 90 %. Without the area of the fit, 26 were above
    90 %, of which 24 were right: feet fit on hands.

    Curvature was added later, with the other numbers as they were. Its rate was set on 48 searches with other cuts of
    people and animals, 17 of them single limbs. 23 of their first maps are above 90 %, all of them right (13 without
    curvature); at the rate of the fit, 26 right and 3 wrong ones are. Of 46 searched without their right maps, 6 are
    above 90 % (2 without curvature). On 39 searches that set none of these numbers, the first maps above 90 % are all
    right, with and without curvature, and 2 of 37 without their right maps are above 90 % either way. The order of the
    candidates hardly matters: 70 of the 87 first maps are right, with and without curvature. Some of these searches are
    of two fragments, which are no longer compared by curvature.
    """

    another_map: float = tuned(0.1, "length", 0, 2)  # mean distance of images above which two maps are rivals
    rivalry: float = tuned(10.0, "1", 0, 100)  # rate at which the odds of a rival decrease with the lead in score
    misfit: float = tuned(6.6, "1", -100, 100)  # logarithm of the odds against a map whose fit is 0
    misfit_rate: float = tuned(2.3, "1", 0, 100)  # rate at which it increases with the fit
    extent: float = tuned(1.75, "1", 0, 100)  # rate at which it decreases with the logarithm of the area on the whole
    # Rate at which the log odds of a map decrease with its `curvature_score`. At the rate of the fit (2.3), a leg
    # has .95 on the other leg, and an arm .95 on the other arm; now they have .82 and .84.
    curvature_rate: float = tuned(0.8, "1", 0, 100)
    # Rate at which the log odds of a map decrease with the area of the gaps that its part leaves on the whole, beyond
    # the usual area. A person with a leg on the other leg falls from .94 to .71.
    gap_rate: float = tuned(20.0, "per area", 0, 1000)
    # Area of the gaps of right maps: 26 right maps of cut people and animals leave .043 at most. Of six wrong ones, two
    # leave .146 and .165; the other four leave .03 at most, and are torn or less certain than .62.
    usual_gaps: float = tuned(0.05, "area", 0, 1)


@dataclass(frozen=True)
class SmallPartCertaintyTuning(Tuning, set_by="small_parts"):
    """Convert the scores of a small part, such as a hand, to a probability.

    The certainty was fitted to 118 small parts of 14 kinds: hands, feet, heads, arms, paws and tails of people and
    animals. Each was also used without its right maps, with a quarter of the weight. In cross-validation over kinds, 38
    of 39 maps above 90 % were right; the other one maps a cat's right paw to its left one. Of 96 parts without their
    right maps, 4 were above 90 %. With the constants of larger parts, 72 of 74 maps and 22 of 96 parts were.
    """

    rivalry: float = tuned(5.3, "1", 0, 100)  # rate at which the odds of a rival decrease with the lead in score
    misfit: float = tuned(4.65, "1", -100, 100)  # logarithm of the odds against a map whose fit is 0
    misfit_rate: float = tuned(1.3, "1", 0, 100)  # rate at which it increases with the fit


CERTAINTY = CertaintyTuning()
PART_CERTAINTY = PartCertaintyTuning()
SMALL_PART_CERTAINTY = SmallPartCertaintyTuning()


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
    return [*_sort_by_mirror_image(direct, mirrored, source, target), *mirrored]


def _sort_by_mirror_image(
    direct: Sequence[Candidate], mirrored: Sequence[Candidate], source: ShapeAnalysis, target: ShapeAnalysis
) -> list[Candidate]:
    """Direct candidates, with the farthest from the best mirror image first if that image has a much better score.

    Then the bodies are in opposite poses, such as half a stride apart. A map that exchanges only the arms, or only the
    legs, may have a better score than the right one there, but agrees with the mirror image on these limbs. The right
    map differs from the image in all limbs. The first one stays first if the finished map of the farthest fits much
    worse. No candidate is certain in either case, and certainties still fall.
    """
    if not direct or not mirrored:
        return list(direct)
    best, image = (min(side, key=lambda one: one.scores["total"]) for side in (direct, mirrored))
    first = direct[0].scores["total"]
    near = [one for one in direct if one.scores["total"] - first < CERTAINTY.image_rival]
    differences = (_differences(one, image, source, target) for one in near)
    apart = [np.average(distances, weights=areas) for areas, distances in differences]
    if apart[0] >= CERTAINTY.image_apart * max(apart):
        return list(direct)
    lead = best.scores["total"] - image.scores["total"] - CERTAINTY.image_lead
    doubt = CERTAINTY.image / (1 + _odds_of_rival(lead, CERTAINTY.rivalry))
    farthest = near[int(np.argmax(apart))]
    fits = farthest.scores.get(ENERGY, 0.0) <= CERTAINTY.image_energy * direct[0].scores.get(ENERGY, np.inf)
    order = [farthest, *(one for one in direct if one is not farthest)] if lead > 0 and fits else direct
    return [replace(one, certainty=float(at.certainty / (1 + doubt))) for one, at in zip(order, direct, strict=True)]


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


def are_rivals(one: Candidate, other: Candidate, source: ShapeAnalysis, target: ShapeAnalysis) -> bool:
    """Whether two candidates map some limb to different ones, instead of being variants of one map."""
    if other is one:
        return False
    areas, apart = _differences(one, other, source, target)
    return bool(areas[apart > CERTAINTY.elsewhere].sum() > CERTAINTY.rival * areas.sum())


def _differences(
    one: Candidate, other: Candidate, source: ShapeAnalysis, target: ShapeAnalysis
) -> tuple[Floats, Floats]:
    """(p,) the areas around places of the target, and (p,) the distances between their images by two candidates.

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
            rivals += _odds_of_rival(lead, CERTAINTY.rivalry)
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


def certainty_of_part(one: Candidate, found: Sequence[Candidate]) -> float:
    """Probability that a candidate for the place of a part is right, among those that were found."""
    assert one.part_match is not None
    everywhere = one.part_match.region.is_everywhere
    rivals, rivalry = 0.0, PART_CERTAINTY.rivalry if everywhere else SMALL_PART_CERTAINTY.rivalry
    for other in found:
        if other is one or other.part_match is None:
            continue
        if images_apart(one.part_match, other.part_match) > PART_CERTAINTY.another_map:
            lead = other.scores["total"] - one.scores["total"]
            rivals += _odds_of_rival(lead, rivalry)
    alone = certainty_of_fit(one.scores) if everywhere else _certainty_of_small(one.scores)
    return float(alone / (1 + rivals))


def certainty_of_fit(scores: Mapping[str, float]) -> float:
    """Probability that a part with these scores is in the right place if it has no rivals."""
    odds = -PART_CERTAINTY.misfit - PART_CERTAINTY.misfit_rate * scores["fit"]
    odds -= PART_CERTAINTY.curvature_rate * curvature_score(scores)
    odds -= PART_CERTAINTY.gap_rate * max(scores.get(GAPS, 0.0) - PART_CERTAINTY.usual_gaps, 0.0)
    return float(expit(odds + PART_CERTAINTY.extent * np.log(scores["extent"] + 0.01)))


def _certainty_of_small(scores: Mapping[str, float]) -> float:
    """The same for a small part, such as a hand."""
    return float(expit(-SMALL_PART_CERTAINTY.misfit - SMALL_PART_CERTAINTY.misfit_rate * scores["fit"]))


def _odds_of_rival(lead: float, rivalry: float) -> float:
    """Odds of a rival against a candidate that leads it in score; they decrease with the lead at the rate `rivalry`."""
    return float(np.exp(-rivalry * np.clip(lead, -CERTAINTY.largest_lead, CERTAINTY.largest_lead)))


@once_per_argument
def is_closed(shape: ShapeAnalysis) -> bool:
    """Whether nothing can be missing; a hull is closed whatever it is around."""
    return not shape.proxy.full.is_hull and not len(border_edges(shape.mesh.triangles))


def certainty_but_for_turns(candidates: Sequence[Candidate]) -> float:
    """Probability that the first candidate is right up to a rotational symmetry."""
    first = candidates[0]
    return first.certainty if first.turns == 1 else sum(one.certainty for one in candidates if one.turns > 1)


def confirmed_certainty(certainty: float, undecided: float, confirming: float) -> float:
    """The certainty of a candidate after another body's candidate confirmed its map.

    Args:
        certainty: the candidate's own.
        undecided: the largest certainty of a rival that the other candidate confirms as well; 0 if it decides.
        confirming: the certainty of the other candidate.
    """
    share = certainty / max(certainty + undecided, 1e-300)
    return max(certainty, share * confirming)


def certainty_of_torn(certainty: float, torn: float, torn_off: float, closed: bool) -> float:
    """The certainty of a candidate after its final map turned out to be torn.

    Args:
        certainty: the candidate's own.
        torn: the part of the target's area at torn edges. Only maps of closed shapes are doubted for it.
        torn_off: the part of the target's area that tears cut off from the rest.
        closed: whether both shapes are closed.
    """
    if torn_off <= VERDICT.torn_off and (torn <= VERDICT.torn or not closed):
        return certainty
    return min(certainty, VERDICT.torn_certainty)
