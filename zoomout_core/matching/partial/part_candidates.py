"""Where a part lies on a whole: landmarks are placed, maps refined, and the part is bent onto the whole by each."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, unlikeness
from zoomout_core.matching.partial.landmark_search import SEARCH, assignments, distinct, landmarks_of
from zoomout_core.matching.partial.part_registration import RegisteredPart, registered_steps
from zoomout_core.matching.partial.slanted_maps import extended, slanted_map
from zoomout_core.matching.scores import fit_in_space, orientation_agreement
from zoomout_core.runtime.stepping import drain, scaled
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PartCandidateTuning(Tuning, set_by="partial"):
    """Which maps of a part are compared, and by what; lengths are those of the larger shape at unit area.

    Attributes:
        searches: for landmarks: their number, and the weight of the sense in which they turn.
        same_map: maps whose images are nearer than this on average are the same.
        registered: maps that the part is bent by, those that promise most.
        facing: weight of the logarithm of the mean deviation of normals in what a map promises,
        place: of the mean distance from the whole,
        distance: of the mean change of geodesic distances,
        unlikeness: of the mean unlikeness of places,
        orientation: and of the share of triangles that keep their orientation.
        strain: weight of the logarithm of the strain in the score, beside that of normals.
    """

    searches: tuple[tuple[int, float], ...] = tuned(
        ((9, 0.6), (6, 0.6), (14, 0.6), (9, 0.0)), "landmarks, and 1", 0, 100
    )
    same_map: float = tuned(0.05, "length", 0, 10)
    registered: int = tuned(10, "maps", 1, 1000)
    facing: float = tuned(1.0, "1", 0, 100)
    place: float = tuned(0.3, "1", 0, 100)
    distance: float = tuned(0.15, "1", 0, 100)
    unlikeness: float = tuned(0.15, "1", 0, 100)
    orientation: float = tuned(0.25, "1", 0, 100)
    strain: float = tuned(0.5, "1", 0, 100)


PART_CANDIDATES = PartCandidateTuning()


@dataclass(frozen=True, eq=False)
class PartCandidate:
    """A map of a part to a whole.

    Attributes:
        match: (s,) for each search sample of the part the number of a sample of the whole.
        registered: the part, bent by it.
        scores: what it promised, those of the registered part, and the fit by these: the smallest is the most likely.
    """

    match: Integers
    registered: RegisteredPart
    scores: dict[str, float]


def part_candidates_steps(part: IncompleteShape, whole: IncompleteShape) -> Generator[float, None, list[PartCandidate]]:
    """Maps of a part to a whole that keep the orientation, the most likely first; yields the fraction done."""
    unlike = unlikeness(part, whole)
    _ = part.turning, whole.turning  # before several threads ask for it
    searching = for_each(lambda how: _searched(unlike, part, whole, *how), PART_CANDIDATES.searches)
    found = yield from scaled(searching, 0.0, 0.4)
    matches = [match for each in found for match in each]
    promises = yield from scaled(for_each(lambda match: _promise(match, unlike, part, whole), matches), 0.4, 0.5)
    best = np.argsort(promises, kind="stable")
    kept: list[int] = []
    for number in best:
        if all(images_apart(matches[number], matches[k], whole) > PART_CANDIDATES.same_map for k in kept):
            kept.append(int(number))
    kept = kept[: PART_CANDIDATES.registered]
    registering = for_each(lambda number: _registered(matches[number], promises[number], part, whole), kept)
    candidates = yield from scaled(registering, 0.5, 1.0)
    return sorted(candidates, key=lambda candidate: candidate.scores["fit"])


def _searched(
    unlike: Floats, part: IncompleteShape, whole: IncompleteShape, landmarks: int, turning: float
) -> list[Integers]:
    """Maps (s,) of samples that landmarks on different places lead to."""
    chosen = landmarks_of(part, landmarks)
    placed = assignments(chosen, unlike, part, whole, turning)
    return [
        slanted_map(extended(chosen, placed[number], unlike, part, whole), part, whole)
        for number in distinct(placed, whole)
    ]


def images_apart(match: Integers, other: Integers, whole: IncompleteShape) -> float:
    """Mean distance along the whole between the images of two maps (s,) of samples."""
    place = whole.shape.nearest_distance_sample
    return float(whole.between[place[match], place[other]].mean())


def _promise(match: Integers, unlike: Floats, part: IncompleteShape, whole: IncompleteShape) -> float:
    """How little a map promises before the part is bent by it: the least is the best."""
    area = part.shape.basis.areas.sum()
    fit = fit_in_space(match, None, False, whole.shape, part.shape)
    weights = part.shape.weights / area
    place = whole.shape.nearest_distance_sample[match]
    first = place[: len(part.between)]
    difference = np.abs(part.between - whole.between[np.ix_(first, first)])
    in_doubt = ~part.unaffected & (part.between > whole.between[np.ix_(first, first)])
    difference[in_doubt] *= SEARCH.doubt
    return float(
        PART_CANDIDATES.facing * np.log(fit["facing"] / area + 0.01)
        + PART_CANDIDATES.place * np.log(fit["place"] / area / np.sqrt(area) + 1e-9)
        + PART_CANDIDATES.distance * np.log(difference.mean() + 1e-9)
        + PART_CANDIDATES.unlikeness * np.log(weights @ unlike[part.shape.nearest_distance_sample, place] + 0.003)
        - PART_CANDIDATES.orientation * orientation_agreement(match, whole.shape, part.shape)
    )


def _registered(match: Integers, promise: float, part: IncompleteShape, whole: IncompleteShape) -> PartCandidate:
    registered = drain(registered_steps(match, part, whole))
    scores = registered.scores(part.shape.basis.areas)
    fit = np.log(scores["normals"] + 0.01) + PART_CANDIDATES.strain * np.log(scores["strain"] + 0.02)
    return PartCandidate(match, registered, scores | {"promise": promise, "fit": float(fit)})
