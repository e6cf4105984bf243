# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points are exact, in space and in embeddings."""

from __future__ import annotations

import numpy as np
from creatures import Creature

from zoomout_core.geometry.closest_points import barycentric_of_closest, closest_points
from zoomout_core.geometry.embedded_surface import Neighbourhoods, project_to_embedding


def distances(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(q, m) distance of every point to every triangle, by minimising over a fine grid of each triangle."""
    steps = 60
    u, v = (axis.ravel() / steps for axis in np.meshgrid(np.arange(steps + 1), np.arange(steps + 1)))
    grid = np.column_stack([u, v, 1 - u - v])[u + v <= 1 + 1e-9]
    samples = np.einsum("gc,mcx->mgx", grid, vertices[triangles])
    return np.stack([np.linalg.norm(samples - p, axis=2).min(axis=1) for p in points])


def at(vertices: np.ndarray, triangles: np.ndarray, triangle: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    return np.einsum("qc,qcx->qx", barycentric, vertices[triangles[triangle]])


def test_closest_points_agree_with_brute_force() -> None:
    random = np.random.default_rng(0)
    # Intersecting triangles of very different sizes.
    centres = random.standard_normal((60, 1, 3)) * 2
    soup = (centres + random.standard_normal((60, 3, 3)) * 10 ** random.uniform(-2, 0.5, (60, 1, 1))).reshape(-1, 3)
    triangles = np.arange(180).reshape(-1, 3)
    points = random.standard_normal((40, 3)) * 3
    triangle, barycentric = closest_points(points, soup, triangles)
    assert barycentric.min() >= 0
    np.testing.assert_allclose(barycentric.sum(axis=1), 1, atol=1e-12)
    found = np.linalg.norm(at(soup, triangles, triangle, barycentric) - points, axis=1)
    brute = distances(points, soup, triangles).min(axis=1)
    assert (found <= brute + 1e-9).all()
    np.testing.assert_allclose(found, brute, atol=0.1)


def test_points_on_the_surface_are_returned_exactly(resting: Creature) -> None:
    vertices, triangles = resting.surface.vertices, resting.surface.triangles
    random = np.random.default_rng(1)
    triangle = random.integers(len(triangles), size=5000)
    barycentric = random.dirichlet([1, 1, 1], 5000)
    points = at(vertices, triangles, triangle, barycentric)
    found = at(vertices, triangles, *closest_points(points, vertices, triangles))
    np.testing.assert_allclose(found, points, atol=1e-12)


def test_queries_of_one_point_or_none_are_answered() -> None:
    corners = np.eye(3)
    triangle, barycentric = closest_points(np.array([[2.0, 2, 2]]), corners, np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(triangle, [0])
    np.testing.assert_allclose(barycentric, [[1 / 3, 1 / 3, 1 / 3]])
    triangle, barycentric = closest_points(np.zeros((0, 3)), corners, np.array([[0, 1, 2]]))
    assert triangle.shape == (0,)
    assert barycentric.shape == (0, 3)


def test_approximate_search_stays_within_its_tolerance(resting: Creature) -> None:
    vertices, triangles = resting.surface.vertices, resting.surface.triangles
    points = vertices[::11] + np.random.default_rng(3).normal(scale=0.1, size=vertices[::11].shape)
    exact, near = (
        np.linalg.norm(at(vertices, triangles, *closest_points(points, vertices, triangles, off)) - points, axis=1)
        for off in (0.0, 0.3)
    )
    assert (near >= exact - 1e-12).all()
    assert (near - exact).max() <= 0.3
    assert (near - exact).max() > 0


def test_degenerate_triangles_have_closest_points() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 3, 3], [3, 3, 3], [3, 3, 3]])
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    points = np.array([[1.5, 1, 0], [4, 3, 3]])
    triangle, barycentric = closest_points(points, vertices, triangles)
    assert np.array_equal(triangle, [0, 1])
    np.testing.assert_allclose(at(vertices, triangles, triangle, barycentric), [[1.5, 0, 0], [3, 3, 3]], atol=1e-12)


def test_projection_in_an_embedding_finds_the_closest_point(resting: Creature) -> None:
    random = np.random.default_rng(2)
    vertices, triangles = resting.surface.vertices, resting.surface.triangles
    lift = np.linalg.qr(random.standard_normal((40, 3)))[0].T
    embedding = vertices @ lift  # distances in the embedding equal those in space
    points = vertices[random.integers(len(vertices), size=2000)] + random.normal(scale=0.02, size=(2000, 3))
    nearest = np.argmin(((points[:, None] - vertices) ** 2).sum(axis=2), axis=1)
    triangle, barycentric = project_to_embedding(
        points @ lift, embedding, Neighbourhoods(triangles, len(vertices)), nearest
    )
    exact = closest_points(points, vertices, triangles)
    found, best = (
        np.linalg.norm(at(vertices, triangles, *place) - points, axis=1) for place in ((triangle, barycentric), exact)
    )
    np.testing.assert_allclose(found, best, atol=1e-4)  # single precision


def test_barycentric_coordinates_cover_all_seven_regions() -> None:
    a, b, c = np.array([[0.0, 0], [1, 0], [0, 1]])
    points = np.array([[-1, -1], [2, -0.5], [-0.5, 2], [0.5, -1], [-1, 0.5], [1, 1], [0.25, 0.25]])
    expected = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5], [0.5, 0.25, 0.25]]
    ap, ab, ac = points - a, b - a, c - a
    dots = (ap @ ab, ap @ ac, np.full(7, ab @ ab), np.full(7, ab @ ac), np.full(7, ac @ ac))
    np.testing.assert_allclose(barycentric_of_closest(dots), expected, atol=1e-12)


def test_projection_stays_exact_far_from_the_origin(resting: Creature) -> None:
    mesh = resting.surface
    far = mesh.vertices[:500] + 1e3
    inside = (mesh.triangles < 500).all(axis=1)
    triangles = mesh.triangles[inside]
    used = np.unique(triangles)
    around = Neighbourhoods(triangles, 500)
    triangle, barycentric = project_to_embedding(far[used], far, around, used)
    off = np.einsum("qc,qcx->qx", barycentric, far[triangles[triangle]]) - far[used]
    assert np.abs(off).max() < 1e-5
