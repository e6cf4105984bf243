# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial maps from a few paired landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature, mirrored_vertex, true_vertex
from shapes import sheet, truth

from zoomout_core.maps.upsample import nearest_samples
from zoomout_core.matching.hypotheses.landmarks import landmark_hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.landmark_features import LANDMARKS
from zoomout_core.mesh.surface import Surface

SOURCE, TARGET = creature(300), creature(280, seed=1)
AXES = ([1, 0.1, 0.35], [-1, 0.1, 0.35], [0.45, 0, -1], [-0.45, 0, -1], [0, 1, -0.25])


def shape_of(surface: Surface, k: int = 40) -> ShapeAnalysis:
    return analyse(surface.working.part(0)[0], k, 150, 0)


@pytest.mark.parametrize("vertex", [true_vertex(SOURCE, TARGET), mirrored_vertex(SOURCE, TARGET)])
def test_landmarks_give_the_direct_or_the_mirrored_map(vertex: np.ndarray) -> None:
    source, target = shape_of(SOURCE.surface), shape_of(TARGET.surface)
    tips = (TARGET.directions @ np.transpose(AXES)).argmax(axis=0)
    hypothesis = landmark_hypothesis(source, target, vertex[tips], tips)
    assert hypothesis.origin == "5 landmarks"
    assert 5 <= len(hypothesis.functional_map) <= 20
    image = source.search.samples[nearest_samples(source.search, target.search, hypothesis.functional_map)]
    wanted = vertex[target.search.samples]
    assert np.linalg.norm(source.mesh.vertices[image] - source.mesh.vertices[wanted], axis=1).mean() < 0.3
    held = hypothesis.anchors
    assert held is not None
    image = np.linalg.norm(held.target[:, None] - held.source, axis=2).argmin(axis=1)
    off = np.linalg.norm(source.mesh.vertices[image] - source.mesh.vertices[vertex], axis=1).mean()
    # The sense in which landmarks surround a point fits only an orientation-preserving map.
    assert (off < 0.1) == np.array_equal(vertex, true_vertex(SOURCE, TARGET))


def test_few_functions_suffice_for_a_landmark_map() -> None:
    source, target = shape_of(SOURCE.surface, 6), shape_of(TARGET.surface, 40)
    tips = (SOURCE.directions @ np.transpose(AXES)).argmax(axis=0)
    for one, other in ((source, target), (target, source)):
        ids = tips, (TARGET.directions @ np.transpose(AXES)).argmax(axis=0)
        ids = ids if one is source else ids[::-1]
        assert landmark_hypothesis(one, other, *ids).functional_map.shape == (6, 6)


def test_landmarks_on_cloth_have_no_turns() -> None:
    source, target = sheet(250, seed=0), sheet(220, seed=1)
    picked = np.array([3, 100, 180])
    ids = truth(source, target)[picked], picked
    shapes = shape_of(source.surface), shape_of(target.surface)
    anchors = landmark_hypothesis(*shapes, *ids).anchors
    assert anchors is not None
    assert not anchors.target[:, 3:].any()
    assert shape_of(SOURCE.surface).mesh.sides_are_known


def test_hundreds_of_landmarks_are_reduced_to_distant_ones() -> None:
    """Functions of all pairs of 280 landmarks would take 150 MB and minutes."""
    source, target = shape_of(SOURCE.surface), shape_of(TARGET.surface)
    ids = np.arange(len(TARGET.directions))
    hypothesis = landmark_hypothesis(source, target, true_vertex(SOURCE, TARGET), ids)
    assert hypothesis.origin == "280 landmarks"
    assert hypothesis.anchors is not None
    turns = LANDMARKS.turning * (LANDMARKS.turning - 1) // 2
    assert hypothesis.anchors.source.shape == (300, LANDMARKS.max_count + turns)
    image = np.linalg.norm(hypothesis.anchors.target[:, None] - hypothesis.anchors.source, axis=2).argmin(axis=1)
    off = source.mesh.vertices[image] - source.mesh.vertices[true_vertex(SOURCE, TARGET)]
    assert np.linalg.norm(off, axis=1).mean() < 0.05
