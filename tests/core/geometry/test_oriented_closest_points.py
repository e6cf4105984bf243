# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points with similar normals, for triangles of any size."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface, surface_samples

# Two large sheets, one above the other, the upper one facing down.
SHEETS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0.02], [1, 0, 0.02], [1, 1, 0.02], [0, 1, 0.02]])
CORNERS = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]])
UP, DOWN = np.array([[0, 0, 1.0]]), np.array([[0, 0, -1.0]])


def sheets(flipped: bool = False) -> OrientedSurface:
    return OrientedSurface(SHEETS, CORNERS, np.full(4, flipped), 0.03)


def test_normals_decide_between_layers() -> None:
    place = np.array([[0.3, 0.6, 0.01]])
    assert sheets().closest(place, UP)[0] in (0, 1)
    assert sheets().closest(place, DOWN)[0] in (2, 3)
    assert sheets(flipped=True).closest(place, UP)[0] in (2, 3)


def test_closest_point_inside_a_large_triangle_is_exact() -> None:
    place = np.array([[0.317, 0.642, -0.2]])
    triangle, barycentric, distance = sheets().closest(place, UP)
    assert np.allclose(barycentric @ SHEETS[CORNERS[triangle[0]]], [0.317, 0.642, 0])
    assert distance[0] == pytest.approx(0.2)


def test_traits_decide_between_layers() -> None:
    surface = OrientedSurface(SHEETS, CORNERS, np.zeros(4, bool), 0.0, traits=np.array([[0.0], [0.0], [0.1], [0.1]]))
    places, ups = np.repeat([[0.3, 0.6, 0.01]], 2, axis=0), np.repeat(UP, 2, axis=0)
    lower, upper = surface.closest(places, ups, traits=np.array([[0.0], [0.1]]))[0]
    assert lower in (0, 1)
    assert upper in (2, 3)


@pytest.mark.parametrize("unit", [1.0, 1e5])
def test_queries_find_only_points_of_their_own_group(unit: float) -> None:
    group = np.array([0, 0, 2, 2])
    surface = OrientedSurface(unit * SHEETS, CORNERS, np.zeros(4, bool), 0.03 * unit, group)
    place = unit * np.repeat([[0.3, 0.6, 0.0]], 2, axis=0)
    triangle, _, distance = surface.closest(place, np.repeat(UP, 2, axis=0), np.array([0, 2]))
    assert triangle[0] in (0, 1)
    assert triangle[1] in (2, 3)
    assert distance == pytest.approx([0, 0.02 * unit])


def test_nearer_of_two_layers_with_equal_normals_is_found() -> None:
    # The upper sheet is wound downwards and marked as flipped.
    surface = OrientedSurface(SHEETS, CORNERS, np.array([False, False, True, True]), 0.03)
    for height, found in ((0.006, (0, 1)), (0.014, (2, 3))):
        assert surface.closest(np.array([[0.3, 0.6, height]]), UP)[0] in found


def test_triangles_of_equal_size_get_equally_many_samples() -> None:
    strip = np.array([[i // 2, i % 2, 0] for i in range(12)], dtype=float)
    corners = np.array([[i, i + 1, i + 2] for i in range(10)])
    np.testing.assert_array_equal(surface_samples(strip, corners, 10)[1], np.arange(10))
    np.testing.assert_array_equal(surface_samples(strip, corners, 20)[1], np.repeat(np.arange(10), 2))


@pytest.mark.parametrize("unit", [1.0, 1e-4])
def test_search_without_normals_agrees_with_the_exact_search(unit: float) -> None:
    mesh = creature(1500).surface
    vertices, places = unit * mesh.vertices, unit * mesh.vertices[::7] * 1.01
    exact = closest_points(places, vertices, mesh.triangles)
    surface = OrientedSurface(vertices, mesh.triangles, np.zeros(len(mesh.triangles), bool), 1e-9 * unit)
    _, _, distance = surface.closest(places, np.zeros_like(places))
    found = np.einsum("qc,qcx->qx", exact[1], vertices[mesh.triangles[exact[0]]])
    assert np.abs(distance - np.linalg.norm(found - places, axis=1)).mean() < 1e-3 * unit


def test_samples_lie_on_triangles_in_proportion_to_area() -> None:
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, -1, 0.0], [1, 0, 0]])
    triangles = np.array([[0, 1, 2], [0, 3, 4]])  # areas 2 and 0.5
    points, triangle = surface_samples(vertices, triangles, 1000)
    assert (triangle == 0).mean() == pytest.approx(0.8, abs=0.01)
    assert (points[triangle == 0] >= 0).all()
    assert points[triangle == 0].mean(axis=0) == pytest.approx([2 / 3, 2 / 3, 0], abs=0.02)


def test_groups_of_tiny_triangles_are_found() -> None:
    tiny = np.array([[0.5, 0.5, 0.5], [0.5001, 0.5, 0.5], [0.5, 0.5001, 0.5]])
    vertices, corners = np.vstack([SHEETS, tiny]), np.vstack([CORNERS, [[8, 9, 10]]])
    surface = OrientedSurface(vertices, corners, np.zeros(5, bool), 0.03, np.array([0, 0, 0, 0, 1]))
    triangle, _, distance = surface.closest(np.array([[0.1, 0.1, 0.0]]), UP, np.array([1]))
    assert triangle[0] == 4
    assert distance[0] == pytest.approx(np.linalg.norm([0.4, 0.4, 0.5]), abs=1e-3)


def test_block_size_does_not_change_results(monkeypatch) -> None:
    places = np.random.default_rng(0).uniform(0, 1, (40, 3)) * [1, 1, 0.02]
    normals = np.repeat(UP, 40, axis=0)
    whole = sheets().closest(places, normals)
    monkeypatch.setattr("zoomout_core.geometry.oriented_closest_points.QUERIES_AT_ONCE", 7)
    for ours, theirs in zip(sheets().closest(places, normals), whole, strict=True):
        np.testing.assert_array_equal(ours, theirs)
