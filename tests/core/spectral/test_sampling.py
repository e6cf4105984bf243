# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples cover the shape and depend only on the shape."""

from __future__ import annotations

import numpy as np
from creatures import Creature
from scipy.spatial import cKDTree

from zoomout_core.spectral.sampling import farthest_points, voronoi_areas


def test_samples_cover_evenly_and_are_distinct(resting: Creature) -> None:
    points = resting.surface.vertices
    samples = farthest_points(points, 200)
    assert len(np.unique(samples)) == 200
    hole = cKDTree(points[samples]).query(points)[0].max()
    gap = cKDTree(points[samples]).query(points[samples], k=2)[0][:, 1].min()
    assert hole <= gap + 1e-12  # no point is farther from the samples than they are from each other


def test_samples_do_not_depend_on_vertex_order_or_placement(resting: Creature) -> None:
    points = resting.surface.vertices
    order = np.random.default_rng(0).permutation(len(points))
    rotation = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    first = farthest_points(points, 100)
    second = farthest_points((points @ rotation)[order] * 10 + 3, 100)
    np.testing.assert_array_equal(order[second], first)


def test_all_points_are_sampled_if_there_are_fewer(resting: Creature) -> None:
    assert np.array_equal(np.sort(farthest_points(resting.surface.vertices[:50], 80)), np.arange(50))


def test_voronoi_areas_sum_to_one() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1.1, 0, 0], [2, 0, 0]])
    weights = voronoi_areas(points, np.array([1.0, 2, 3, 4]), np.array([0, 1]))
    np.testing.assert_allclose(weights, [0.1, 0.9])
