# SPDX-License-Identifier: GPL-3.0-or-later
"""Ablation of the automatic match: the map that results without each stage.

The dense refinement does not depend on what comes before it, so it is left out: a candidate is judged by the nearest
neighbours of its own functional map. Without a source of hypotheses, or without anchors, hypotheses are
refined and ranked again; without a criterion the candidates of the match are ranked again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.maps.anchors import coordinates
from zoomout_core.maps.nearest import nearest
from zoomout_core.matching.hypotheses.descriptors import descriptor_hypotheses
from zoomout_core.matching.hypotheses.extremities import extremity_hypotheses
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.hypotheses.signs import sign_hypotheses
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import sort_by_certainty
from zoomout_core.matching.ranking.rank import rank
from zoomout_core.matching.ranking.scores import ENERGY, scores_of, total_score
from zoomout_core.matching.result import MatchResult

SOURCES = {
    "extremities": extremity_hypotheses,
    "descriptors": descriptor_hypotheses,
    "signs": sign_hypotheses,
}
# With these scores, a criterion contributes nothing to the total.
NEUTRAL = {
    "commutativity": {"commutativity": 1.0},
    "frequency": {"frequency": 1.0},
    "distance": {"distance": 1.0},
    "curvature": {"curvature": 0.0},
    "handedness": {"handedness": 0.0},
    "fit in space": {"place": 1.0, "facing": 1.0},
    "finished maps": {ENERGY: 1.0},
}


def maps_without(result: MatchResult) -> dict[str, Integers]:
    """The vertex map (n_t,), -1 for no image, that results without each stage of a match.

    Args:
        result: of an automatic match without landmarks.
    """
    best = {"all": result.candidates[0], **_with_other_hypotheses(result.pair), **_with_other_scores(result)}
    maps: dict[int, Integers] = {}  # mostly the same candidate wins, so each map is computed once
    for candidate in best.values():
        if id(candidate.functional_map) not in maps:
            maps[id(candidate.functional_map)] = vertex_map(candidate, result.pair)
    return {name: maps[id(candidate.functional_map)] for name, candidate in best.items()}


def _with_other_hypotheses(pair: Pair) -> dict[str, Candidate]:
    """The best candidate without each source of hypotheses (if any hypotheses remain), and without anchors."""
    shapes = pair.source_shape, pair.target_shape
    by_source = {name: generate(*shapes) for name, generate in SOURCES.items()}
    pools: dict[str, list[Hypothesis]] = {
        f"without {left_out}": [
            hypothesis for name, hypotheses in by_source.items() if name != left_out for hypothesis in hypotheses
        ]
        for left_out in SOURCES
    }
    pools["without anchors"] = [
        replace(hypothesis, anchors=None) for hypotheses in by_source.values() for hypothesis in hypotheses
    ]
    return {name: rank(hypotheses, *shapes)[0] for name, hypotheses in pools.items() if hypotheses}


def _with_other_scores(result: MatchResult) -> dict[str, Candidate]:
    """The match's best candidate without each criterion, and by the scores of one direction only."""
    source, target = result.pair.source_shape, result.pair.target_shape
    scores = {
        f"without {name}": [candidate.scores | neutral for candidate in result.candidates]
        for name, neutral in NEUTRAL.items()
    }
    scores["without the reverse map"] = [
        candidate.scores
        | scores_of(candidate.functional_map, candidate.sample_map, source, target, candidate.reverses_orientation)
        for candidate in result.candidates
    ]
    return {
        name: sort_by_certainty(
            [
                replace(candidate, scores=other | {"total": total_score(other)})
                for candidate, other in zip(result.candidates, others, strict=True)
            ],
            source,
            target,
        )[0]
        for name, others in scores.items()
    }


def vertex_map(candidate: Candidate, pair: Pair) -> Integers:
    """(n_t,) source vertex of each target vertex, by the candidate's functional map; -1 off the largest part."""
    source, target = pair.source_shape, pair.target_shape
    bases = target.basis.eigenvectors, source.basis.eigenvectors
    image = nearest(*coordinates(*bases, candidate.functional_map, candidate.anchors))
    inside = source.proxy.full.vertex_of >= 0
    on_surface = np.empty(len(source.proxy.full.vertices), dtype=np.int64)
    on_surface[source.proxy.full.vertex_of[inside]] = np.flatnonzero(inside)
    of_part = on_surface[source.proxy.full_vertex[image]][target.proxy.place.vertex]
    return np.where(target.proxy.full.vertex_of >= 0, of_part[target.proxy.full.vertex_of], -1)
