# SPDX-License-Identifier: GPL-3.0-or-later
"""Collect the initial hypotheses of a match: from generators, landmarks, positions in space, an earlier map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from typing import TypeAlias

from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.nearest import nearest
from zoomout_core.matching.components.overlap import overlapping
from zoomout_core.matching.constraints import Constraints
from zoomout_core.matching.hypotheses.descriptors import descriptor_hypotheses
from zoomout_core.matching.hypotheses.extremities import (
    extremity_hypotheses,
    has_extremities,
    more_extremity_hypotheses,
)
from zoomout_core.matching.hypotheses.given import proximity_hypothesis
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.hypotheses.landmarks import landmark_hypothesis
from zoomout_core.matching.hypotheses.signs import sign_hypotheses
from zoomout_core.matching.options import Initial
from zoomout_core.matching.pair import Pair, landmarks_on_parts
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.scores import Disagreement
from zoomout_core.runtime.threads import for_each

# Makes hypotheses from two shapes and a function that measures how far a map disagrees with the evidence.
Generator: TypeAlias = Callable[[ShapeAnalysis, ShapeAnalysis, Disagreement], list[Hypothesis]]

# Add another way of making hypotheses here.
GENERATORS: tuple[Generator, ...] = (extremity_hypotheses, descriptor_hypotheses)
# Tried if these lead to no likely map.
MORE_GENERATORS: tuple[Generator, ...] = (more_extremity_hypotheses,)
# Weight of a landmark's functions against those of hypothetical pairs, which may contradict it.
LANDMARK_WEIGHT = 2.0


def collect_hypotheses(
    pair: Pair,
    initial: Initial,  # option of the match
    evidence: Constraints,
    disagreement: Disagreement,  # with the evidence
    earlier: Hypothesis | None,  # that of a map that the user gave
    by_landmarks: Hypothesis | None,  # that of the user's landmarks, see `hypothesis_of_landmarks`
) -> list[Hypothesis]:
    """The initial hypotheses of a match."""
    source, target = pair.source_shape, pair.target_shape
    if initial == "given" and earlier is not None:
        return [earlier]
    if initial == "proximity":
        return [proximity_hypothesis(pair)]
    hypotheses = _generate(pair, GENERATORS, disagreement)
    if not (has_extremities(source) and has_extremities(target)):
        # They are many, and on 40 pairs of shapes with extremities they added no success.
        hypotheses += sign_hypotheses(source, target)
    if evidence.in_space is not None:
        hypotheses.insert(0, proximity_hypothesis(pair))
    if earlier is not None:
        hypotheses.insert(0, earlier)
    anchors = evidence.anchors(pair)
    if by_landmarks is not None:
        assert by_landmarks.anchors is not None
        hypotheses.insert(0, replace(by_landmarks, anchors=None))
        anchors = by_landmarks.anchors.scale(LANDMARK_WEIGHT).join(anchors)
    return _anchor(hypotheses, anchors)


def hypothesis_of_landmarks(pair: Pair, evidence: Constraints) -> Hypothesis | None:
    """The map that the user's landmarks suggest; None if there are none."""
    if evidence.landmarks is None:
        return None
    return landmark_hypothesis(pair.source_shape, pair.target_shape, *landmarks_on_parts(pair, evidence.landmarks))


def more_hypotheses(pair: Pair, evidence: Constraints, disagreement: Disagreement) -> list[Hypothesis]:
    """More hypotheses, if those of `collect_hypotheses` lead to no likely map."""
    return _anchor(_generate(pair, MORE_GENERATORS, disagreement), evidence.anchors(pair))


def gather_evidence(pair: Pair, known: Constraints, earlier: Hypothesis | None) -> Constraints:
    """All evidence on the map of a pair: from the user, an earlier map, and positions in space."""
    source, target = pair.source_shape, pair.target_shape
    if earlier is not None:
        rows = target.search.rows, source.basis.eigenvectors
        known = replace(known, earlier=nearest(*coordinates(*rows, earlier.functional_map, None)))
    places = None if pair.source is pair.target else overlapping(pair)  # a surface always coincides with itself
    return known if places is None else replace(known, in_space=places[target.search.samples])


def _generate(pair: Pair, generators: Sequence[Generator], disagreement: Disagreement) -> list[Hypothesis]:
    shapes = pair.source_shape, pair.target_shape
    return list(chain.from_iterable(for_each(lambda make: make(*shapes, disagreement), generators)))


def _anchor(hypotheses: list[Hypothesis], anchors: Anchors | None) -> list[Hypothesis]:
    """Hypotheses with landmarks as constraints of the final map, whatever they start from."""
    if anchors is None:
        return hypotheses
    held = [anchors.join(each.anchors) for each in hypotheses]
    return [replace(each, anchors=both, final_anchors=both) for each, both in zip(hypotheses, held, strict=True)]
