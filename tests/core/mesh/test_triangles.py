# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges, areas, normals and triangulation, compared with values computed by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from zoomout_core.mesh.triangles import (
    TRIANGLES,
    area_normals,
    at_all,
    at_any,
    border_edges,
    edge_graph,
    edge_lengths,
    have_three_corners,
    sides_by_edge,
    triangle_areas,
    triangle_normals,
    unique_edges,
    vertex_areas,
    vertex_normals,
)
from zoomout_core.mesh.triangulation import triangulate

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])


def test_each_edge_is_listed_once_with_its_sides() -> None:
    edges, edge_of = unique_edges(TETRAHEDRON)
    assert sorted(map(tuple, edges.tolist())) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for triangle, numbers in zip(TETRAHEDRON, edge_of, strict=True):
        for (a, b), number in zip(pairwise([*triangle, triangle[0]]), numbers, strict=True):
            assert edges[number].tolist() == sorted([a, b])
    sides = sides_by_edge(TETRAHEDRON)
    assert np.diff(sides.first).tolist() == [2] * 6
    assert sorted(sides.side.tolist()) == list(range(12))
    fin = np.concatenate([TETRAHEDRON, [[0, 1, 4]]])
    assert sorted(np.diff(sides_by_edge(fin).first).tolist()) == [1, 1, 2, 2, 2, 2, 2, 3]


def test_border_edges_belong_to_one_triangle() -> None:
    assert len(border_edges(TETRAHEDRON)) == 0
    assert sorted(map(tuple, border_edges(TETRAHEDRON[1:]).tolist())) == [(0, 1), (0, 2), (1, 2)]


def test_edge_graph_has_edge_lengths_in_both_directions() -> None:
    graph = edge_graph(CORNER, TETRAHEDRON).toarray()
    distance = np.linalg.norm(CORNER[:, None] - CORNER, axis=2)
    np.testing.assert_allclose(graph, distance)


def test_areas_and_normals_of_a_corner() -> None:
    np.testing.assert_allclose(triangle_areas(CORNER, TETRAHEDRON), [1, 1.5, 3.5, 3])
    np.testing.assert_allclose(triangle_normals(CORNER, TETRAHEDRON[[0, 1, 3]]), [[0, 0, -1], [0, -1, 0], [-1, 0, 0]])
    np.testing.assert_allclose(vertex_areas(CORNER, TETRAHEDRON), np.array([5.5, 6, 7.5, 8]) / 3)
    # Faces are weighted by area.
    np.testing.assert_allclose(vertex_normals(CORNER, TETRAHEDRON)[0], -np.array([3, 1.5, 1]) / 3.5)
    flat = np.array([[0, 1, 1]])
    assert (triangle_normals(CORNER, flat) == 0).all()
    assert (vertex_normals(CORNER, TETRAHEDRON[:1])[3] == 0).all()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_normals_of_more_than_one_block_are_cross_products(dtype: type) -> None:
    random = np.random.default_rng(0)
    vertices = random.standard_normal((100, 3)).astype(dtype)
    triangles = random.integers(0, 100, (TRIANGLES + 5, 3))
    a, b, c = (vertices[corner] for corner in triangles.T)
    found = area_normals(vertices, triangles)
    assert found.dtype == dtype
    np.testing.assert_allclose(found, np.cross(b - a, c - a), atol=1e-5)


def test_triangles_and_edges_at_vertices_are_found() -> None:
    chosen = np.array([True, True, True, False])
    assert at_all(chosen, TETRAHEDRON).tolist() == [True, False, False, False]
    assert at_any(~chosen, TETRAHEDRON).tolist() == [False, True, True, True]
    edges = np.array([[0, 1], [0, 3]])
    assert at_all(chosen, edges).tolist() == [True, False]
    assert at_any(chosen, edges).tolist() == [True, True]


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("notch", [0.2, 0.9])
def test_quads_are_split_without_folds(first: int, notch: float) -> None:
    # An arrowhead or a kite, listed from any corner.
    ring = np.roll(np.array([[0.0, 0, 0], [1, 0, 0], [notch, notch, 0], [0, 1, 0]]), first, axis=0)
    triangles = triangulate(ring, np.arange(4), np.array([0, 4]))
    area = triangle_areas(ring, triangles).sum()
    assert area == pytest.approx(notch)
    assert (triangle_normals(ring, triangles)[:, 2] > 0.99).all()
    assert sorted(np.unique(triangles)) == [0, 1, 2, 3]


def test_polygons_of_several_sizes_keep_their_corners() -> None:
    turn = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    hexagon = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    vertices = np.concatenate([hexagon, hexagon[:4] + np.array([5, 0, 0]), hexagon[:3] + np.array([9, 0, 0])])
    triangles = triangulate(vertices, np.arange(13), np.array([0, 6, 10, 13]))
    assert len(triangles) == 4 + 2 + 1
    assert [len(np.unique(part)) for part in (triangles[:4], triangles[4:6], triangles[6:])] == [6, 4, 3]
    assert triangles[:4].max() < 6 <= triangles[4:6].min()
    assert triangles[4:6].max() < 10 <= triangles[6:].min()


def test_edge_lengths_and_repeated_corners_are_found() -> None:
    assert edge_lengths(CORNER, np.array([[0, 1], [3, 0], [2, 2]])).tolist() == [1, 3, 0]
    triangles = np.array([[0, 1, 2], [0, 0, 1], [0, 1, 1], [1, 0, 1]])
    assert have_three_corners(triangles).tolist() == [True, False, False, False]
