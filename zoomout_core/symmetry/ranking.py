# SPDX-License-Identifier: GPL-3.0-or-later
"""Decide which maps of a shape onto itself are symmetries, and with what certainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from zoomout_core.arrays import Integers
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import CERTAINTY
from zoomout_core.matching.ranking.scores import correlation, map_after_alignment
from zoomout_core.symmetry.involution import displacement, mean_distance
from zoomout_core.tuning import Tuning, tuned

# Points that a map moves by less than this, at unit area, are fixed. The fixed share of the area is limited, because
# rotations fix only single points, and reflections only a line.
FIXED_DISTANCE = 0.1
MAX_FIXED_SHARE_OF_ROTATIONS = 0.15
MAX_FIXED_SHARE_OF_REFLECTIONS = 0.45
# Candidates of a higher certainty are all considered right; reflections come first, since they can mirror sides.
SURE_SYMMETRY_CERTAINTY = 0.98


@dataclass(frozen=True)
class CriterionTuning(Tuning, set_by="symmetry"):
    """Weights of the criteria for scoring a candidate.

    Errors count by their logarithms, and are clamped to the size that meshes alone cause.

    Attributes:
        commutativity: weight of the error of commutativity.
        min_commutativity: minimum of this error.
        distance: weight of the error of distances.
        min_distance: minimum of this error.
        place: weight of the error of places.
        min_place: minimum of this error.
        curvature: weight of one minus the correlation of curvatures.
        min_curvature: minimum of this difference.
        handedness: weight of the correlation of pseudo-scalars.
        moved: weight of the logarithm of the mean distance that a map moves points. Points that move little have small
            errors, and this compensates for it. Otherwise, a map that leaves the arms in place and exchanges only the
            legs would have smaller errors than the right one.
        turn: how much better rotations have to score than reflections, because living things rarely have rotational
            symmetry.
    """

    commutativity: float = tuned(-3.4, "1", -100, 0)
    min_commutativity: float = tuned(0.1, "1", 1e-9, 1)
    distance: float = tuned(-1.7, "1", -100, 0)
    min_distance: float = tuned(0.01, "1", 1e-9, 1)
    place: float = tuned(-2.7, "1", -100, 0)
    min_place: float = tuned(0.002, "1", 1e-9, 1)
    curvature: float = tuned(-1.2, "1", -100, 0)
    min_curvature: float = tuned(0.01, "1", 1e-9, 1)
    handedness: float = tuned(2.8, "1", 0, 100)
    moved: float = tuned(5.0, "1", 0, 100)
    turn: float = tuned(2.7, "1", 0, 100)


@dataclass(frozen=True)
class OddsTuning(Tuning, set_by="symmetry"):
    """The log odds that a map is right, which grow with its score and with its lead over the next best map.

    Fitted, like the weights of the criteria, to 218 people, animals, gorillas, game characters and dressed bodies of
    many shells, at rest and in poses. These are used again without their right maps, with a weight of a twentieth. 26
    heaps and twigs without symmetry have a weight of a tenth. Fitted with one of 16 kinds left
    out and tested on it, 215 of 218 first maps were right. Of these 174 had a certainty of at least 90 %, of the wrong
    ones none did, and no heap had more than 72 %.

    Attributes:
        score_rate: log odds for each unit of the score.
        lead_rate: log odds for each unit of the lead.
        largest_lead: limit of the lead in either direction.
        at_zero: log odds at a score and a lead of zero.
    """

    score_rate: float = tuned(0.193, "1", 0, 100)
    lead_rate: float = tuned(0.755, "1", 0, 100)
    largest_lead: float = tuned(4.0, "score", 0, 1000)
    at_zero: float = tuned(-3.59, "1", -100, 100)


# Log odds of exact symmetries, of which a shape may have several: the commutativity error of a map of 60 functions at
# even odds, the slope per unit of its logarithm, and the slope per unit of the score behind the best map.
EVEN_ODDS_COMMUTATIVITY = 0.43
EXACTNESS_SLOPE = 16
EXACTNESS_LAG_SLOPE = 1.0


CRITERIA = CriterionTuning()
ODDS = OddsTuning()


def is_no_part_of_identity(sample_map: Integers, reverses_orientation: bool, shape: ShapeAnalysis) -> bool:
    """Whether a map (s,) of a shape's search samples moves enough of it; moving only a limb is not a symmetry."""
    fixed = shape.weights @ (displacement(sample_map, shape) < FIXED_DISTANCE)
    most = MAX_FIXED_SHARE_OF_REFLECTIONS if reverses_orientation else MAX_FIXED_SHARE_OF_ROTATIONS
    return bool(fixed <= most)


def rank_symmetries(candidates: list[Candidate], shape: ShapeAnalysis) -> list[Candidate]:
    """Distinct candidates with scores and certainties of a symmetry, the most likely first.

    Among certain ones, reflections come before rotations.
    """
    ranked = sorted((_score(candidate, shape) for candidate in candidates), key=lambda one: one.scores["total"])
    distinct: list[Candidate] = []
    for candidate in ranked:
        # A rotation and a reflection are distinct, however close their images are.
        alike = [other for other in distinct if other.reverses_orientation == candidate.reverses_orientation]
        if all(_apart(candidate, other, shape) > CERTAINTY.another_map for other in alike):
            distinct.append(candidate)
    rated = [replace(candidate, certainty=_certainty(candidate, distinct)) for candidate in distinct]
    return sorted(rated, key=_sort_key)


def _sort_key(candidate: Candidate) -> tuple[float, bool, float, float]:
    """Sort key of candidates: the best is the smallest."""
    turns = not candidate.reverses_orientation
    return -min(candidate.certainty, SURE_SYMMETRY_CERTAINTY), turns, -candidate.certainty, candidate.scores["total"]


def _apart(one: Candidate, other: Candidate, shape: ShapeAnalysis) -> float:
    """Mean distance along the surface between the images of two maps, at unit area."""
    images = shape.nearest_distance_sample[one.sample_map]
    return float(shape.weights @ shape.distances_between[images, other.sample_map])


def _score(candidate: Candidate, shape: ShapeAnalysis) -> Candidate:
    moved = mean_distance(candidate.sample_map, shape)
    scores = candidate.scores | {"fine handedness": _fine_handedness(candidate, shape), "moved": moved}
    errors = (
        (CRITERIA.commutativity, scores["commutativity"], CRITERIA.min_commutativity),
        (CRITERIA.distance, scores["distance"], CRITERIA.min_distance),
        (CRITERIA.place, scores["place"], CRITERIA.min_place),
    )
    total = sum(weight * np.log(max(error, least)) for weight, error, least in errors)
    total += CRITERIA.curvature * np.log(max(1 - scores["curvature"], CRITERIA.min_curvature))
    total += CRITERIA.handedness * scores["fine handedness"] + CRITERIA.moved * np.log(max(moved, 1e-9))
    total -= 0 if candidate.reverses_orientation else CRITERIA.turn
    return replace(candidate, scores=scores | {"total": -float(total)})


def _certainty(candidate: Candidate, candidates: list[Candidate]) -> float:
    """The probability that a map is right, from its score and its lead over all others, or its exactness."""
    others = [other.scores["total"] for other in candidates if other is not candidate]
    lead = min(others, default=np.inf) - candidate.scores["total"]
    clipped = np.clip(lead, -ODDS.largest_lead, ODDS.largest_lead)
    by_lead = ODDS.at_zero - ODDS.score_rate * candidate.scores["total"] + ODDS.lead_rate * clipped
    commuting = np.log(EVEN_ODDS_COMMUTATIVITY / max(candidate.scores["commutativity"], 1e-9))
    exact = EXACTNESS_SLOPE * commuting + EXACTNESS_LAG_SLOPE * min(lead, 0)
    return float(expit(max(by_lead, exact)))


def _fine_handedness(candidate: Candidate, shape: ShapeAnalysis) -> float:
    """Mean correlation of pseudo-scalars, with their sign changed if the map reverses the orientation.

    Limbs that the map mirrors individually, which the Laplacian allows, are corrected first.
    """
    image, _ = map_after_alignment(candidate.sample_map, None, candidate.mirrored, shape, shape)
    pseudo_scalars = shape.descriptors[1]
    # Fewer functions than needed may be independent at samples, so they are taken from the basis itself.
    here, there = (shape.basis.eigenvectors[vertices] @ pseudo_scalars for vertices in (shape.search.samples, image))
    return (-1 if candidate.reverses_orientation else 1) * correlation(here, there, shape.weights)
