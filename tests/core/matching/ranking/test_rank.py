# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranking distinguishes the right map from its mirror image, and duplicates from new maps."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, mirrored_vertex, true_vertex
from scipy.spatial import cKDTree

from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.ranking.rank import rank
from zoomout_core.matching.ranking.scores import orientation_agreement, scores_of
from zoomout_core.mesh.surface import Surface


@pytest.fixture(scope="module")
def shapes(resting: Creature, bent: Creature) -> tuple[ShapeAnalysis, ShapeAnalysis]:
    source, target = (analyse(creature.surface.working.part(0)[0], 100, 500, 0) for creature in (resting, bent))
    return source, target


def sample_map(vertex: np.ndarray, source: ShapeAnalysis, target: ShapeAnalysis) -> np.ndarray:
    """A vertex map as a map between search samples: the source sample nearest to each image."""
    samples = source.mesh.vertices[source.search.samples]
    return np.asarray(cKDTree(samples).query(source.mesh.vertices[vertex[target.search.samples]])[1])


def test_orientation_agrees_for_the_true_map_only(shapes, resting, bent) -> None:
    for vertex, sign in ((true_vertex(resting, bent), 1), (mirrored_vertex(resting, bent), -1)):
        assert sign * orientation_agreement(sample_map(vertex, *shapes), *shapes) > 0.8


def test_every_criterion_prefers_the_true_map_to_a_wrong_one(shapes, resting, bent) -> None:
    source, target = shapes
    truth = true_vertex(resting, bent)
    turned = np.asarray(cKDTree(resting.directions).query(bent.directions * [-1, -1, 1])[1])  # half turn
    scores = []
    for vertex in (truth, turned):
        C = functional_map_of(vertex, source.basis, target.basis, 60, 60)
        scores.append(scores_of(C, sample_map(vertex, source, target), source, target, False))
    right, wrong = scores
    for smaller in ("commutativity", "frequency", "distance"):
        assert right[smaller] < wrong[smaller]
    for larger in ("curvature", "handedness"):
        assert right[larger] > wrong[larger]
    assert right["handedness"] > 0.1


def test_handedness_distinguishes_a_mirror_image(shapes, resting) -> None:
    source = shapes[0]
    mirror = Surface(resting.surface.vertices * [-1, 1, 1], resting.surface.triangles[:, ::-1])
    target = analyse(mirror.working, 100, 500, 0)
    identity = np.arange(len(source.search.samples))
    for reverses, expected in ((False, -1), (True, 1)):
        scores = scores_of(np.eye(60), identity, source, target, reverses)
        np.testing.assert_allclose([scores["handedness"], scores["curvature"]], [expected, 1], atol=1e-3)


def test_duplicates_are_dropped_and_candidates_sorted(shapes, resting, bent) -> None:
    source, target = shapes
    maps = [
        functional_map_of(f(resting, bent), source.basis, target.basis, 12, 12) for f in (true_vertex, mirrored_vertex)
    ]
    hypotheses = [Hypothesis("mirrored", maps[1]), Hypothesis("true", maps[0]), Hypothesis("true again", maps[0])]
    candidates = rank(hypotheses, source, target)
    assert [candidate.reverses_orientation for candidate in candidates] == [False, True]
    assert candidates[0].origin.startswith("true")
