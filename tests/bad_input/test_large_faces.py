# SPDX-License-Identifier: GPL-3.0-or-later
"""Polygons of thousands of corners and fans of thousands of triangles need no more memory than other meshes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.geometry.closest_points import consecutive
from zoomout_core.geometry.embedded_surface import HUB, Neighbourhoods
from zoomout_core.mesh.triangulation import MAX_FAN

MANY = 2000


def rim(count: int) -> np.ndarray:
    """(count, 3) points of an ellipse that waves."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(angle), 1.3 * np.sin(angle), 0.2 * np.cos(3 * angle)])


def bicone(count: int) -> zo.Surface:
    """Two fans of triangles on a common rim."""
    around = np.arange(count) + 2
    sides = np.column_stack([around, np.roll(around, -1)])
    tips = np.array([[0, 0, 1.0], [0, 0, -1.0]])
    faces = [np.column_stack([sides[:, ::step], np.full(count, tip)]) for tip, step in enumerate((1, -1))]
    return zo.Surface(np.vstack([tips, rim(count)]), np.concatenate(faces))


def test_the_triangles_of_a_large_polygon_do_not_all_meet_at_one_vertex() -> None:
    surface = zo.Surface(rim(10_000) * [1, 1, 0], [np.arange(10_000)])
    assert len(surface.triangles) == 9998
    assert np.bincount(surface.triangles.ravel()).max() < 40
    assert surface.area == pytest.approx(1.3 * np.pi, rel=1e-5)


def test_small_polygon_stays_a_fan() -> None:
    surface = zo.Surface(rim(MAX_FAN) * [1, 1, 0], [np.arange(MAX_FAN)])
    assert (surface.triangles[:, 0] == 0).all()


def test_neighbourhoods_do_not_cross_the_tip_of_a_fan() -> None:
    surface = bicone(MANY)
    near = Neighbourhoods(surface.triangles, len(surface.vertices))
    assert len(near.triangle) < 20 * len(surface.triangles)  # 6,000 times as many as through the tips
    sizes = np.diff(near.first_triangle)
    np.testing.assert_array_equal(sizes[:2], MANY + MANY)  # of a tip, with the triangles beyond the rim
    np.testing.assert_array_equal(sizes[2:], 8)
    assert (surface.triangles[near.triangle[near.first_triangle[2] :]] == 2).any()


def test_neighbourhoods_cross_vertices_with_few_triangles() -> None:
    surface = bicone(HUB)
    near = Neighbourhoods(surface.triangles, len(surface.vertices))
    np.testing.assert_array_equal(np.diff(near.first_triangle), 2 * HUB)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("kind", [zo.Kind.SCALAR, zo.Kind.LABEL])
def test_a_transfer_between_fans_needs_little_memory(kind: zo.Kind) -> None:
    source, target = bicone(MANY), bicone(MANY)
    number = np.arange(len(source.triangles))
    values = number.astype(float) if kind == zo.Kind.SCALAR else number // 50
    same = zo.SurfaceMap.from_vertices(np.arange(len(source.vertices)), source)
    tracemalloc.start()
    found = zo.transfer(zo.Attribute("it", zo.Domain.FACE, kind, values), same, source, target).values
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 200 << 20  # 8 GB with all pairs at once
    assert (np.abs(found - values) < 1).mean() > 0.95


@pytest.mark.slow
def test_a_match_of_fans_needs_little_memory() -> None:
    tracemalloc.start()
    assert zo.match(bicone(MANY), bicone(MANY), k_final=20, samples=60).surface_map.vertex.shape == (MANY + 2,)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 400 << 20


def test_blocks_contain_all_items_in_order() -> None:
    sizes = np.array([3, 1, 50, 2, 2, 0, 9, 1])
    blocks = consecutive(sizes, 10)
    np.testing.assert_array_equal(np.concatenate(blocks), np.arange(8))
    assert all(sizes[block[1:]].sum() < 10 for block in blocks)
    assert [block.tolist() for block in consecutive(sizes[:0], 10)] == [[]]
