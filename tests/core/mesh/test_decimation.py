# SPDX-License-Identifier: GPL-3.0-or-later
"""Decimation reaches the requested size, preserves the surface and maps every vertex."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature
from scipy.spatial import ConvexHull, cKDTree
from trimesh.remesh import subdivide

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh import decimation
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas


def fine_creature() -> Surface:
    """A creature with about 120,000 vertices."""
    coarse = creature(30000).surface
    return Surface(*subdivide(coarse.vertices, coarse.triangles))


@pytest.mark.slow
def test_a_large_mesh_keeps_its_surface_and_its_topology() -> None:
    working = fine_creature().working
    points, triangles, _ = decimate(working.vertices, working.oriented_triangles, 3000)
    assert 2900 < len(points) < 3100
    result = Surface(points, triangles).working
    assert result.component.max() == 0
    assert not result.flipped.any()
    assert len(points) - len(triangles) / 2 == len(working.vertices) - len(working.triangles) / 2  # Euler
    assert abs(triangle_areas(points, triangles).sum() - 1) < 0.02
    triangle, barycentric = closest_points(working.vertices, points, triangles)
    foot = np.einsum("nc,ncx->nx", barycentric, points[triangles[triangle]])
    off = np.linalg.norm(foot - working.vertices, axis=1)
    assert np.quantile(off, 0.99) < 0.004
    assert off.max() < 0.03


def test_every_vertex_maps_to_a_nearby_one() -> None:
    working = fine_creature().working
    points, _, merged = decimate(working.vertices, working.oriented_triangles, 3000)
    away = np.linalg.norm(points[merged] - working.vertices, axis=1)
    nearest = cKDTree(points).query(working.vertices)[0]
    assert merged.shape == (len(working.vertices),)
    assert np.median(away) < 2 * np.median(nearest)
    assert np.quantile(away, 0.999) < 0.1


def test_coarse_limbs_of_a_large_mesh_are_not_thinned_away() -> None:
    """A four-sided tube beside a very dense body: the tube's vertices are too far apart to merge."""
    body = fine_creature().working
    ring = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]) * 0.02
    tube = np.concatenate([np.add(ring, (0, 0, 2 + 0.1 * level)) for level in range(9)])
    quads = np.array(
        [[4 * i + j, 4 * i + (j + 1) % 4, 4 * i + 4 + (j + 1) % 4, 4 * i + 4 + j] for i in range(8) for j in range(4)]
    )
    sides = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]) + len(body.vertices)
    vertices = np.concatenate([body.vertices, tube])
    triangles = np.concatenate([body.oriented_triangles, sides])
    points, faces, _ = decimate(vertices, triangles, 3000)
    on_tube = points[faces].mean(axis=1)[:, 2] > 1.95
    area = triangle_areas(points, faces)[on_tube].sum()
    assert area > 0.9 * triangle_areas(vertices, sides).sum()


@pytest.mark.parametrize("unit", [0.001, 0.3937, 1000.0])
def test_facets_of_remeshed_solids_decimate_alike_in_every_unit(unit: float) -> None:
    points = np.random.default_rng(3).standard_normal((12, 3))
    vertices, triangles = points / np.linalg.norm(points, axis=1, keepdims=True), ConvexHull(points).simplices
    for _ in range(4):
        vertices, triangles = subdivide(vertices, triangles)
    in_units = [Surface((scale * vertices).astype(np.float32), triangles).working for scale in (1, unit)]
    found = [decimate(each.vertices, each.oriented_triangles, 600) for each in in_units]
    places, others = (points[merged] for points, _, merged in found)
    assert (np.linalg.norm(others - places, axis=1) < 1e-3).mean() > 0.99


def test_round_shapes_are_not_displaced(monkeypatch: pytest.MonkeyPatch) -> None:
    working = creature(2500).surface.working
    points = decimate(working.vertices, working.oriented_triangles, 600)[0]
    monkeypatch.setattr(decimation, "JITTER", 0.2)
    np.testing.assert_array_equal(decimate(working.vertices, working.oriented_triangles, 600)[0], points)


def test_meshes_below_the_requested_size_are_unchanged() -> None:
    working = creature(2000).surface.working
    points, triangles, merged = decimate(working.vertices, working.oriented_triangles, 4000)
    np.testing.assert_allclose(points, working.vertices, atol=1e-6)
    np.testing.assert_array_equal(merged, np.arange(2000))
    assert len(triangles) == len(working.triangles)
