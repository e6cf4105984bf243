# SPDX-License-Identifier: GPL-3.0-or-later
"""The certainty of a candidate: the probability that its map is right as a whole, with no sides or limbs exchanged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.scores import ENERGY, SCORES, TORN
from zoomout_core.matching.refinement.local_rigid_alignment import sides_are_known
from zoomout_core.mesh.triangles import border_edges
from zoomout_core.runtime.once import once_per_argument
from zoomout_core.tuning import Tuning, tuned


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
    unlikely: float = tuned(0.5, "probability", 0, 1)  # more hypotheses are tried below this certainty


CERTAINTY = CertaintyTuning()


def sort_by_certainty(candidates: list[Candidate], source: ShapeAnalysis, target: ShapeAnalysis) -> list[Candidate]:
    """Candidates with their certainty, the most likely first.

    Mirror images come last and rival only each other, unless the sides are unknown, such as those of a cloth.
    """
    apart = sides_are_known(source, target)
    sides = [[one for one in candidates if one.mirrored == side] for side in (False, True)] if apart else [candidates]
    return [one for side in sides for one in _sort_rivals(side, source, target)]


@once_per_argument
def is_closed(shape: ShapeAnalysis) -> bool:
    """Whether nothing can be missing; a hull is closed whatever it is around."""
    return not shape.proxy.full.is_hull and not len(border_edges(shape.mesh.triangles))


def _sort_rivals(rivals: Sequence[Candidate], source: ShapeAnalysis, target: ShapeAnalysis) -> list[Candidate]:
    """Candidates that rival each other, with their certainty, which never rises from one to the next."""
    totals = _totals(rivals)
    order = np.argsort(totals, kind="stable")
    ranked, totals = [rivals[i] for i in order], totals[order]
    certainties = [_certainty(number, ranked, totals, source, target) for number in range(len(ranked))]
    falling = np.minimum.accumulate(certainties)
    return [replace(one, certainty=float(certainty)) for one, certainty in zip(ranked, falling, strict=True)]


def _totals(candidates: Sequence[Candidate]) -> Floats:
    """(c,) total scores with the energies of finished maps; an unknown energy counts as the largest known one."""
    energies = np.array([candidate.scores.get(ENERGY, np.nan) for candidate in candidates])
    known = np.isfinite(energies)
    filled = np.where(known, energies, energies[known].max()) if known.any() else np.ones(len(energies))
    totals = np.array([candidate.scores["total"] for candidate in candidates])
    return np.asarray(totals + SCORES.energy * np.log(np.maximum(filled, 1e-9)))


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
        tears = CERTAINTY.tear_rate * np.log1p(scores.get(TORN, 0.0) / CERTAINTY.tear)
        log_odds += min(tears, CERTAINTY.tear_limit) - CERTAINTY.closed
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
    return other.scores["total"] - one.scores["total"] + SCORES.energy * float(np.log(ratio))
