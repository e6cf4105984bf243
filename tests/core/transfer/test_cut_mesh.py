# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut surfaces: their connected parts, and walks that do not cross a cut."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import directions
from transfer_meshes import sheet, sphere, split_at_faces, torus, tube

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.cut_mesh import adjacent_edges, cut_surface, nearer_than


def uncut(surface: Surface) -> np.ndarray:
    return np.zeros((len(surface.corner_vertex), 1))


def test_closed_surface_has_no_border_and_two_faces_per_edge() -> None:
    for mesh in (sheet(torus, 60, 40).surface, split_at_faces(sheet(torus, 60, 40).surface)[0]):
        first, second = adjacent_edges(mesh)
        assert len(first) == 2 * 60 * 40
        ends = mesh.vertices[mesh.corner_vertex[first]], mesh.vertices[mesh.corner_vertex[second]]
        assert (ends[0] == ends[1]).all()
        cut = cut_surface(mesh, uncut(mesh))
        assert len(cut.border) == 0
        assert cut.island.max() == 0
        assert cut.cut_vertex.max() + 1 == 60 * 40


def test_faces_at_a_non_manifold_edge_join_where_values_agree() -> None:
    vertices = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]], dtype=float)
    fins = Surface(vertices, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    first, _ = adjacent_edges(fins)
    assert len(first) == 3
    values = np.array([0, 0, 0, 5, 5, 5, 0, 0, 0], dtype=float)[:, None]
    island = cut_surface(fins, values).island
    assert island[0] == island[2]
    assert island[0] != island[1]


def test_only_jumps_above_noise_cut_an_edge() -> None:
    mesh = sheet(tube, 60, 40)
    values = mesh.corners.copy()
    cut = cut_surface(mesh.surface, values)
    assert cut.island.max() == 0
    assert len(cut.border) == 2 * 60 + 2 * 40  # both ends, and both sides of the seam
    noise = np.random.default_rng(0).uniform(-1, 1, values.shape) * 1e-6
    assert len(cut_surface(mesh.surface, values + noise).border) == len(cut.border)


def test_walks_reach_every_point_of_their_component() -> None:
    surface = sphere(directions(20000, seed=0))
    random = np.random.default_rng(0)
    triangle = random.integers(0, len(surface.triangles), 5000)
    barycentric = random.dirichlet([1, 1, 1], 5000)
    points = np.einsum("qc,qcx->qx", barycentric, surface.vertices[surface.triangles[triangle]])
    start = closest_points(points + 0.1 * random.normal(size=points.shape), surface.vertices, surface.triangles)[0]
    found, weights, left = cut_surface(surface, uncut(surface)).walk(start, points)
    assert (left == 0).all()
    assert (found == triangle).all()
    assert weights == pytest.approx(barycentric, abs=1e-6)


def test_walks_stop_at_a_cut() -> None:
    mesh = sheet(tube, 120, 80)
    surface = mesh.surface
    cut = cut_surface(surface, mesh.corners)
    column = np.floor(mesh.middles[:, 0] * 120).astype(int)[surface.triangle_face]
    start, goal = np.flatnonzero(column == 0), np.flatnonzero(column == 119)
    points = surface.vertices[surface.triangles[goal]].mean(axis=1)
    found, _, left = cut.walk(start, points)
    assert (column[found] == 0).all()
    assert (left > 0).all()
    found, _, left = cut_surface(surface, uncut(surface)).walk(start, points)
    assert (found == goal).all()
    assert (left == 0).all()


def test_walks_cross_steep_slivers() -> None:
    # Hexagons with a straight side, whose middle corner is slightly off the plane and makes a sliver.
    surface = sheet(torus, 120, 80, sides=6).surface
    triangle = np.arange(len(surface.triangles))
    middle = surface.vertices[surface.triangles].mean(axis=1)
    at_vertex = np.empty(len(surface.vertices), dtype=int)
    at_vertex[surface.triangles.ravel()] = np.repeat(triangle, 3)
    for corner in range(3):
        start = at_vertex[surface.triangles[:, corner]]
        found, _, left = cut_surface(surface, uncut(surface)).walk(start, middle)
        assert (left == 0).all()
        assert (found == triangle).all()


def test_balls_near_a_segment_are_never_missed() -> None:
    random = np.random.default_rng(0)
    begin = random.random((200, 3))
    end = begin + 0.2 * random.normal(size=(200, 3))
    points, radius = random.random((3000, 3)), random.uniform(0.01, 0.03, 3000)
    along = end - begin
    part = np.clip(np.einsum("qsx,sx->qs", points[:, None] - begin, along) / np.einsum("sx,sx->s", along, along), 0, 1)
    distance = np.linalg.norm(points[:, None] - begin - part[..., None] * along, axis=2).min(axis=1)
    found = nearer_than(points, radius, begin, end)
    assert found[distance <= radius].all()
    assert not found[distance > 3 * radius + 0.03].any()
