# SPDX-License-Identifier: GPL-3.0-or-later
"""Features of every vertex from a few places: their distances, and the sense in which pairs surround it."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature
from scipy.sparse.csgraph import dijkstra

from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.landmark_features import LandmarkFeatures, landmark_features
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.spectral.descriptors import pseudo_scalars

MADE = creature(500)
AXES = ([1, 0.1, 0.35], [-1, 0.1, 0.35], [0.45, 0, -1], [-0.45, 0, -1], [0, 1, -0.25])
TIPS = (MADE.directions @ np.transpose(AXES)).argmax(axis=0)


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    return analyse(MADE.surface.working.part(0)[0], 60, 500, 0)


@pytest.fixture(scope="module")
def places(shape: ShapeAnalysis) -> LandmarkFeatures:
    return landmark_features(shape, TIPS)


def test_distances_approximate_those_along_the_surface(shape: ShapeAnalysis, places: LandmarkFeatures) -> None:
    exact = dijkstra(edge_graph(shape.mesh.vertices, shape.mesh.triangles), indices=TIPS).T
    assert places.distances.shape == exact.shape
    assert np.abs(places.distances - exact).mean() < 0.05 * exact.mean()


def test_distances_to_one_place_are_a_column(shape: ShapeAnalysis, places: LandmarkFeatures) -> None:
    alone = landmark_features(shape, TIPS[:1])
    np.testing.assert_allclose(alone.distances, places.distances[:, :1])
    assert alone.turns.shape == (500, 1, 1)
    assert alone.features(np.arange(1)).shape == (500, 1)


def test_turns_have_unit_deviation_and_are_antisymmetric(places: LandmarkFeatures) -> None:
    i, j = np.triu_indices(len(TIPS), k=1)
    np.testing.assert_allclose(places.turns[:, i, j].std(axis=0), 1)
    np.testing.assert_array_equal(places.turns, -places.turns.transpose(0, 2, 1))


def test_distances_and_turns_are_smoothed_a_little(shape: ShapeAnalysis, places: LandmarkFeatures) -> None:
    exact = dijkstra(edge_graph(shape.mesh.vertices, shape.mesh.triangles), indices=TIPS[:2]).T
    rough = pseudo_scalars(shape.mesh, shape.basis.areas, places.distances, *np.array([[0], [1]]))
    for before, after in ((exact[:, :1], places.distances[:, :1]), (rough, places.turns[:, 0, 1:2])):
        left = (shape.basis.coefficients(after) / shape.basis.coefficients(before))[1:, 0]
        assert (np.diff(left) < 0).all()
        assert 0.2 < left[-1] / left[0] < 0.9


def test_coincident_places_have_no_turn(shape: ShapeAnalysis) -> None:
    assert not landmark_features(shape, TIPS[[0, 0]]).turns.any()


def test_turns_tell_the_order_of_two_places_around_a_point(places: LandmarkFeatures) -> None:
    # Seen from outside, the left hand is to the right of the chest and to the left of the back.
    chest, back = MADE.directions @ [0, -1, 0] > 0.9, MADE.directions @ [0, 1, 0.4] > 0.95
    left_hand_and_leg = places.turns[:, 0, 3]
    assert left_hand_and_leg[chest].mean() * left_hand_and_leg[back].mean() < 0


def test_features_have_unit_scale_and_turns_weigh_less(places: LandmarkFeatures) -> None:
    features = places.features(np.arange(5))
    distances, turns = features[:, :5], features[:, 5:]
    assert turns.shape[1] == 10
    assert (distances > 0).mean() > 0.99  # smaller means nearer
    assert (np.corrcoef(distances[:, 0], places.distances[:, 0])[0, 1]) > 0.999
    assert (distances.std(axis=0) > 0.5).all()
    assert (distances.std(axis=0) < 2).all()
    assert 0.1 < turns.std() < 0.7 * distances.std()
    assert (turns[:, 0] * places.turns[:, 0, 1] > 0).mean() > 0.99


def test_distance_features_do_not_depend_on_unit_or_place(places: LandmarkFeatures) -> None:
    larger = LandmarkFeatures(places.vertices, 3 * places.distances, places.turns)
    np.testing.assert_allclose(larger.features(np.arange(5)), places.features(np.arange(5)))
    np.testing.assert_allclose(places.features(np.arange(5))[:, :5].mean(axis=0), places.features(np.arange(1)).mean())


def test_only_the_first_of_many_places_have_turns() -> None:
    many = LandmarkFeatures(np.arange(30), np.ones((4, 30)), np.ones((4, 30, 30)))
    counts = [many.features(np.arange(count)).shape[1] - count for count in (3, 5, 15, 30)]
    assert counts[:2] == [3, 10]
    assert counts[2] == counts[3] < 40
