# SPDX-License-Identifier: GPL-3.0-or-later
"""Point clouds become oriented surfaces through their points, without bridges between nearby limbs."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, directions
from scipy.spatial import ConvexHull, Delaunay

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.reconstruction import _hull_corners, _manifold, triangulate_points
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unique_edges


def bordering(triangles: np.ndarray) -> np.ndarray:
    """Number of triangles that share each edge."""
    _, edge_of = unique_edges(triangles)
    return np.bincount(edge_of.ravel())


def test_sphere_without_normals_is_closed_and_oriented() -> None:
    points = directions(600, seed=2)
    triangles = triangulate_points(points)
    assert len(triangles) >= 0.98 * (2 * len(points) - 4)
    assert bordering(triangles).max() == 2
    outwards = np.einsum("mx,mx->m", triangle_normals(points, triangles), points[triangles].mean(axis=1))
    assert (outwards > 0).all() or (outwards < 0).all()


def test_points_in_a_plane_have_their_delaunay_triangulation() -> None:
    flat = np.random.default_rng(1).uniform(size=(300, 2))
    triangles = triangulate_points(np.column_stack([flat, np.zeros(300)]))
    expected = {tuple(sorted(simplex)) for simplex in Delaunay(flat).simplices}
    found = {tuple(sorted(triangle)) for triangle in triangles.tolist()}
    inner = {
        triangle
        for triangle in expected
        if np.abs(flat[list(triangle)] - 0.5).max() < 0.4  # border points have neighbours on one side only
    }
    assert inner <= found


def test_hull_corners_agree_with_scipy() -> None:
    random = np.random.default_rng(3)
    angle = np.sort(random.uniform(-np.pi, np.pi, (40, 12)), axis=1)
    length = random.uniform(0.2, 2, (40, 12))
    x, y = length * np.cos(angle), length * np.sin(angle)
    corners, following = _hull_corners(np.ones((40, 12), dtype=bool), x, y)
    for row in range(40):
        hull = ConvexHull(np.column_stack([np.append(x[row], 0), np.append(y[row], 0)])).vertices
        assert set(np.flatnonzero(corners[row])) == set(hull) - {12}
        own = np.flatnonzero(corners[row])
        assert following[row, own].tolist() == np.roll(own, -1).tolist()


def test_nearby_sheets_are_not_joined() -> None:
    """Two sheets whose distance is a quarter of their point spacing."""
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    grid = grid + np.random.default_rng(4).uniform(-0.3, 0.3, grid.shape)
    lower = np.column_stack([grid, np.zeros(len(grid))])
    upper = np.column_stack([grid[:, ::-1] + 0.4, np.full(len(grid), 0.25)])
    normals = np.repeat([[0.0, 0, -1], [0, 0, 1]], len(grid), axis=0)
    triangles = triangulate_points(np.concatenate([lower, upper]), normals)
    sheet = triangles // len(grid)
    assert (sheet.min(axis=1) < sheet.max(axis=1)).mean() < 0.05
    assert len(triangles) > 1000


def test_given_normals_determine_the_outside() -> None:
    points = directions(400, seed=5)
    for sense in (1, -1):
        triangles = triangulate_points(points, sense * points)
        facing = np.einsum("mx,mx->m", triangle_normals(points, triangles), points[triangles].mean(axis=1))
        assert (sense * facing > 0).all()


def test_a_creature_is_reconstructed_from_its_vertices_alone(resting: Creature) -> None:
    surface = PointCloud(resting.surface.vertices).surface
    assert 0.85 < surface.area / resting.surface.area < 1.05  # thin limbs lose their tips
    own, true = surface.working, resting.surface.working
    used = (own.vertex_of >= 0) & (true.vertex_of >= 0)
    agreement = np.einsum(
        "nx,nx->n", own.vertex_normals[own.vertex_of[used]], true.vertex_normals[true.vertex_of[used]]
    )
    assert used.mean() > 0.99
    assert (agreement > 0).mean() > 0.95


def test_duplicate_points_merge_and_stray_points_are_left_out() -> None:
    points = directions(300, seed=6)
    cloud = np.concatenate([points[:100], points, 5 + 0.01 * directions(5, seed=0)])
    triangles = triangulate_points(cloud)
    assert len(triangles) >= 0.97 * 596
    assert not np.isin(triangles, np.arange(100, 200)).any()
    assert triangles.max() < 400


def test_points_on_a_line_are_refused() -> None:
    line = np.arange(30.0)[:, None] * [1.0, 2, 3]
    with pytest.raises(MeshError, match="No surface passes through the points"):
        _ = PointCloud(line).surface


def test_as_surface_keeps_surfaces_and_refuses_other_types(resting: Creature) -> None:
    assert as_surface(resting.surface) is resting.surface
    assert isinstance(as_surface(PointCloud(directions(50, seed=1))), Surface)
    with pytest.raises(TypeError, match="A mesh is needed"):
        as_surface(resting.surface.vertices)  # type: ignore[arg-type]


def test_noisy_points_leave_few_holes() -> None:
    random = np.random.default_rng(1)
    ball = directions(700, seed=1) * (1 + 0.06 * random.standard_normal((700, 1)))
    assert (bordering(triangulate_points(ball)) == 1).sum() < 50


def test_inconsistent_and_excess_triangles_are_left_out() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 0, 0]])
    normals = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, -1]])
    triangles = np.array([[0, 1, 3], [0, 1, 2], [2, 1, 3], [1, 3, 4]])
    found = _manifold(triangles, np.array([1, 2, 0, 3]), points, normals)
    assert sorted(map(sorted, found.tolist())) == [[0, 1, 2], [1, 2, 3]]
    assert (triangle_normals(points, found)[:, 2] > 0).all()
