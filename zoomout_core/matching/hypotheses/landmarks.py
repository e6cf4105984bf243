# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypothesis from a few landmarks."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.maps.anchors import Anchors
from zoomout_core.maps.nearest import nearest
from zoomout_core.matching.hypotheses.hypothesis import HYPOTHESES, Hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.landmark_features import LANDMARKS, landmark_features
from zoomout_core.matching.refinement.local_rigid_alignment import sides_are_known
from zoomout_core.spectral.sampling import farthest_points


def landmark_hypothesis(
    source: ShapeAnalysis, target: ShapeAnalysis, source_ids: Integers, target_ids: Integers
) -> Hypothesis:
    """The map that preserves distances to landmarks (m,) of both meshes, and their handedness if sides are known."""
    origin = f"{len(source_ids)} landmarks"
    if len(source_ids) > LANDMARKS.max_count:
        spread = farthest_points(source.mesh.vertices[source_ids], LANDMARKS.max_count)
        source_ids, target_ids = source_ids[spread], target_ids[spread]
    order, side = np.arange(len(source_ids)), int(sides_are_known(source, target))
    of_source, of_target = (
        landmark_features(shape, ids, LANDMARKS.turning) for shape, ids in ((source, source_ids), (target, target_ids))
    )
    anchors = Anchors(of_source.features(order, side), of_target.features(order, side))
    return anchored_hypothesis(origin, source, target, anchors)


def anchored_hypothesis(origin: str, source: ShapeAnalysis, target: ShapeAnalysis, anchors: Anchors) -> Hypothesis:
    """The hypothesis that sends each sample to the one with the most similar anchors."""
    near = anchors.at(source.search.samples, target.search.samples)
    sample_map = nearest(near.target, near.source)
    size = min(HYPOTHESES.anchored_size, source.search.rows.shape[1], target.search.rows.shape[1])
    return Hypothesis(origin, target.search.fit(source.search.rows[sample_map, :size], size), anchors)
