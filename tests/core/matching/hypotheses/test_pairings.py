# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of extremities, and the pairings that are tried."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from creatures import Creature, creature
from scipy.sparse.csgraph import dijkstra

from zoomout_core.matching.hypotheses.extremities import (
    Extremities,
    _all_pairings,
    _persistent_maxima,
    extremities,
    extremity_hypotheses,
    has_extremities,
    pairings,
)
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.landmark_features import LandmarkFeatures
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph


def shape_of(made: Creature) -> ShapeAnalysis:
    return analyse(made.surface.working.part(0)[0], 60, 300, 0)


def tips(between: np.ndarray, persistence: list[float]) -> Extremities:
    """Extremities with given mutual distances and persistence."""
    n = len(between)
    places = LandmarkFeatures(np.arange(n), between, np.zeros((n, n, n)))
    return Extremities(places, between.mean(axis=1), np.array(persistence))


def distances(count: int, seed: int = 0) -> np.ndarray:
    points = np.random.default_rng(seed).standard_normal((count, 3))
    return np.linalg.norm(points[:, None] - points, axis=2)


def pairings_of_all_levels(first: Extremities, second: Extremities) -> set[tuple[tuple[int, int], ...]]:
    return {
        tuple(sorted(zip(of_first.tolist(), of_second.tolist(), strict=True)))
        for of_first, of_second in _all_pairings(first, second)
    }


def test_leading_tips_are_paired_alone_if_persistence_drops() -> None:
    # Four limbs correspond; the small horns are in different places on the two shapes.
    limbs = distances(4)
    persistence = [1.0, 0.9, 0.8, 0.7]
    one, other = (np.pad(limbs, (0, 5), constant_values=3.0) for _ in range(2))
    one[4:, 4:], other[4:, 4:] = distances(5, 1), 5 * distances(5, 2)
    horns = [0.12, 0.11, 0.1, 0.1, 0.1]
    identity = tuple((i, i) for i in range(4))
    assert identity in pairings_of_all_levels(tips(one, persistence + horns), tips(other, persistence + horns))


def test_pairings_that_omit_tips_are_tried() -> None:
    # One limb is in different places on the two shapes.
    between, persistence = distances(6), [1.0, 0.9, 0.8, 0.7, 0.6, 0.5]
    odd = between.copy()
    odd[2], odd[:, 2] = 3 * between[2], 3 * between[:, 2]
    found = pairings(tips(odd, persistence), tips(between, persistence))
    pairs = [tuple(zip(of_first.tolist(), of_second.tolist(), strict=True)) for of_first, of_second in found]
    assert tuple((i, i) for i in range(6) if i != 2) in pairs
    assert {len(pairing) for pairing in pairs} == {3, 4, 5, 6}
    assert all(len(set(of_second)) == len(of_second) for _, of_second in found)


def test_pairing_that_preserves_distances_comes_first() -> None:
    between = distances(6)
    order = np.random.default_rng(3).permutation(6)
    one = tips(between, [1.0, 0.9, 0.8, 0.7, 0.6, 0.5])
    shuffled = tips(7 * between[np.ix_(order, order)], list(7 * np.array([1.0, 0.9, 0.8, 0.7, 0.6, 0.5])[order]))
    of_one, of_other = pairings(one, shuffled)[0]
    np.testing.assert_array_equal(order[of_other], of_one)


@pytest.mark.parametrize("order", [[1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0]])
def test_tips_are_distinguished_by_persistence(order: list[int]) -> None:
    # Three equidistant tips, which distances alone cannot distinguish.
    even, persistence = np.ones((3, 3)) - np.eye(3), np.array([1.0, 0.6, 0.3])
    of_one, of_other = pairings(tips(even, list(persistence)), tips(even, list(persistence[order])))[0]
    np.testing.assert_array_equal(persistence[order][of_other], persistence[of_one])


@pytest.mark.parametrize("order", [[0, 2, 1, 3], [1, 2, 3, 0], [0, 1, 3, 2], [3, 0, 2, 1]])
def test_similar_tips_are_distinguished_by_mutual_distances(order: list[int]) -> None:
    between = np.array([[0.0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
    other = between[np.ix_(order, order)]
    of_one, of_other = pairings(tips(between, [1.0] * 4), tips(other, [1.0] * 4))[0]
    np.testing.assert_array_equal(other[np.ix_(of_other, of_other)], between[np.ix_(of_one, of_one)])


def hills(*heights: float) -> tuple[np.ndarray, Any]:
    """A height function on a closed strip of consecutive hills, with valleys of height zero."""
    profile = np.concatenate([[0.0, height / 2, height, height / 2] for height in heights])
    n = len(profile)
    i = np.arange(n)
    triangles = np.concatenate(
        [np.stack([i, (i + 1) % n, i + n], axis=1), np.stack([(i + 1) % n, (i + 1) % n + n, i + n], axis=1)]
    )
    return np.concatenate([profile, profile - 1e-6]), SimpleNamespace(triangles=triangles)


def test_persistence_is_the_rise_above_the_pass_to_a_higher_hill() -> None:
    values, mesh = hills(1.0, 0.3, 0.7)
    vertices, persistence = _persistent_maxima(values, mesh)
    np.testing.assert_array_equal(vertices, [2, 10, 6])
    np.testing.assert_allclose(persistence, [1.0, 0.7, 0.3], atol=1e-5)
    values[4] = values[3] = 0.2  # a higher pass between the first hill and the second
    vertices, persistence = _persistent_maxima(values, mesh)
    np.testing.assert_allclose(persistence, [1.0, 0.7, 0.15], atol=1e-5)


def test_limbs_are_extremities_and_bumps_are_not() -> None:
    shape = shape_of(creature(600))
    assert has_extremities(shape)
    found = extremities(shape)
    assert 5 <= len(found.vertices) <= 6
    mesh = shape.mesh
    geodesic = dijkstra(edge_graph(mesh.vertices, mesh.triangles), indices=found.vertices)[:, found.vertices]
    np.testing.assert_allclose(found.between, geodesic, atol=0.15 * geodesic.max())
    where = creature(600, without=0).directions
    ball = Surface(where * (1 + 0.02 * np.cos(9 * where[:, :1])), creature(600).surface.triangles)
    rod = Surface(where * [1, 1, 5], creature(600).surface.triangles)  # two ends are too few
    for surface in (ball, rod):
        assert not has_extremities(analyse(surface.working.part(0)[0], 60, 300, 0))


@pytest.mark.parametrize("sides", [(1,), (-1,)])
def test_hypotheses_are_limited_to_the_requested_sides(sides: tuple[int, ...]) -> None:
    source, target = shape_of(creature(300)), shape_of(creature(290, seed=1))
    hypotheses = extremity_hypotheses(source, target, sides=sides)
    assert {"mirrored" in hypothesis.origin for hypothesis in hypotheses} == {side < 0 for side in sides}
    assert all(hypothesis.anchors is not None for hypothesis in hypotheses)
    only = extremity_hypotheses(source, target, wanted=lambda of_target, _: len(of_target) == 4)
    assert {len(hypothesis.origin.split()) - 1 for hypothesis in only} == {4}
