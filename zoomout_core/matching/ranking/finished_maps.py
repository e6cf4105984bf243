# SPDX-License-Identifier: GPL-3.0-or-later
"""Rank the most likely candidates by their finished maps.

On a few hundred samples a map with two legs exchanged may score as well as the right one. Refined at all vertices, it
has to tear or twist the surface between them, which the residual of local similarities detects. It depends neither on
eigenfunctions nor on distances, so it complements the other criteria. If one candidate leads clearly, it alone is
refined: the order needs no more evidence, but the certainty depends on how far its map tears the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import sort_by_certainty
from zoomout_core.matching.ranking.scores import ENERGY, TORN
from zoomout_core.matching.refinement.confidence import local_distortion, torn_triangles
from zoomout_core.matching.refinement.refine import final_size, refine
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FinishedMapTuning(Tuning, set_by="correspondence"):
    """Which candidates to refine before they are ranked, and how far."""

    max_refined: int = tuned(3, "candidates", 2, 100)  # maximum number of refined candidates; 4 rank no better
    # Lag in score up to which candidates are refined. With margins of 1 to 1.5, equally many right maps come first (84
    # of 85 pairs). With 1, however, only 81 % of them are above 90 % certainty, instead of 86 %.
    margin: float = tuned(1.25, "1", 0, 100)
    size: int = tuned(120, "eigenfunctions", 4, 1000)  # size of the functional maps


FINISHED_MAPS = FinishedMapTuning()


def rank_finished(
    candidates: Sequence[Candidate], source: ShapeAnalysis, target: ShapeAnalysis, step: int
) -> list[Candidate]:
    """Candidates in the order of their finished maps, the most likely first, with their certainty.

    Args:
        candidates: maps between two shapes, the most likely first.
        source: the shape that they land on.
        target: the shape that they start from.
        step: growth of the functional map in a round.

    Returns:
        The same maps; those that were refined keep their finished map, and have the scores `ENERGY` and `TORN`. If the
        first one is far ahead, it alone is refined.
    """
    first = candidates[0]
    near = [
        number
        for number, one in enumerate(candidates[: FINISHED_MAPS.max_refined])
        if one.mirrored == first.mirrored and one.scores["total"] - first.scores["total"] < FINISHED_MAPS.margin
    ]
    finished = for_each(lambda number: _finish(candidates[number], source, target, step), near)
    found = list(candidates)
    for number, candidate in zip(near, finished, strict=True):
        found[number] = candidate
    return sort_by_certainty(found, source, target)


def refine_candidate(
    candidate: Candidate, source: ShapeAnalysis, target: ShapeAnalysis, k_final: int, step: int
) -> tuple[SurfaceMap, Floats]:
    """`refine` a candidate, unless the ranking has done so with a functional map of the same size."""
    known = candidate.refined
    if known is not None and len(known[1]) == final_size(source, target, k_final):
        return known
    return refine(source, target, candidate.functional_map, candidate.final_anchors, candidate.mirrored, k_final, step)


def _finish(candidate: Candidate, source: ShapeAnalysis, target: ShapeAnalysis, step: int) -> Candidate:
    """A candidate with its finished map, and the energy and tears of that map, unless it has them already."""
    if candidate.refined is not None:
        return candidate
    refined = refine_candidate(candidate, source, target, FINISHED_MAPS.size, step)
    distortion = local_distortion(refined[0], source, target, candidate.mirrored)
    # 0 for a similarity around every vertex, near 1 for a scattered map.
    energy = float(np.average(distortion, weights=target.basis.areas))
    scores = candidate.scores | {ENERGY: energy, TORN: torn_triangles(refined[0], source, target)}
    return replace(candidate, refined=refined, distortion=distortion, scores=scores)
