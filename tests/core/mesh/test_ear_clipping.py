# SPDX-License-Identifier: GPL-3.0-or-later
"""Polygons of any form are triangulated without overlaps in milliseconds."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest

from zoomout_core.arrays import Floats
from zoomout_core.mesh.ear_clipping import clip_ears
from zoomout_core.mesh.triangulation import triangulate

UP = np.array([0.0, 0, 1])


def twice_area(polygon: Floats) -> float:
    return float(np.cross(polygon, np.roll(polygon, -1, axis=0))[:, 2].sum())


def in_plane(*points: tuple[float, float]) -> Floats:
    return np.array([(x, y, 0.0) for x, y in points])


def star(size: int, seed: int = 0) -> Floats:
    random = np.random.default_rng(seed)
    angle, radius = np.sort(random.random(size)) * 2 * np.pi, 0.2 + random.random(size)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(size)])


def comb(size: int) -> Floats:
    teeth = [(float(x), 10.0 * (x % 2)) for x in range(size)]
    return in_plane((0, -1), (size - 1, -1), *teeth[::-1])


def spiral(size: int) -> Floats:
    turn = np.linspace(0, 6 * np.pi, size)
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(size)])
    return np.concatenate([(turn + 4)[:, None] * circle, ((turn + 1)[:, None] * circle)[::-1]])


def square(half: float, side: int) -> Floats:
    """(4 side, 3) corners of a square, counter-clockwise, with `side` corners on each side."""
    along = np.linspace(-half, half, side, endpoint=False)
    edge = np.full(side, half)
    x, y = np.concatenate([along, edge, -along, -edge]), np.concatenate([-edge, along, edge, -along])
    return np.column_stack([x, y, np.zeros(4 * side)])


def at(x: float, polygon: Floats) -> Floats:
    return polygon + np.array([x, 0, 0])


def with_holes(outside: Floats, *holes: Floats) -> Floats:
    """Cut holes: bridges lead from the outline's first corner to the first of each hole, and back."""
    parts = [outside]
    for hole in holes:
        inside = hole[::-1]
        parts += [outside[:1], inside, inside[:1]]
    return np.concatenate(parts)


POLYGONS = {
    "star": star(600),
    "comb": comb(600),
    "spiral": spiral(300),
    "corners on a line": in_plane((0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 1)),
    "all on one side": in_plane((0, 0), (1, 0), (2, 0), (3, 0), (1, 2)),
    "hole by a bridge": with_holes(square(3, 40), square(1, 40)),
    "two holes from one corner": with_holes(square(3, 10), at(-1, square(0.5, 10)), at(2, square(0.5, 10))),
    "touches its own corner": in_plane((0, 0), (4, 0), (0, 4), (0, 0), (1, 2), (2, 1)),
}


@pytest.mark.parametrize("name", POLYGONS)
def test_triangles_cover_the_polygon_once_in_milliseconds(name: str) -> None:
    polygon = POLYGONS[name]
    start = process_time()
    triangles = clip_ears(polygon, UP)
    assert process_time() - start < 0.5  # 0.05 s on an idle machine; once minutes
    assert triangles.shape == (len(polygon) - 2, 3)
    a, b, c = (polygon[triangles[:, i]] for i in range(3))
    areas = np.cross(b - a, c - a)[:, 2]
    assert areas.min() > 1e-12
    assert areas.sum() == pytest.approx(twice_area(polygon))  # all areas are positive, so triangles do not overlap
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2
    assert (count == 1).sum() == len(polygon)  # the polygon's sides


@pytest.mark.parametrize("seed", range(5))
def test_triangulation_does_not_depend_on_the_frame(seed: int) -> None:
    polygon = star(30, seed)
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    np.testing.assert_array_equal(
        clip_ears(polygon, UP), clip_ears(1e3 * polygon @ turn.T, np.linalg.det(turn) * turn @ UP)
    )


@pytest.mark.parametrize("kind", ["crosses itself", "not in a plane", "all in one place", "on a grid"])
def test_degenerate_polygons_are_triangulated(kind: str) -> None:
    random = np.random.default_rng(0)
    points = {
        "crosses itself": random.random((200, 3)) * [1, 1, 0],
        "not in a plane": random.standard_normal((200, 3)),
        "all in one place": np.zeros((200, 3)),
        "on a grid": random.integers(0, 4, (200, 3)).astype(float),
    }[kind]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    triangles = clip_ears(points, normal)
    assert triangles.shape == (198, 3)
    assert set(triangles.ravel()) == set(range(200))


def test_fans_with_degenerate_triangles_are_avoided() -> None:
    polygon = square(1, 2)
    triangles = triangulate(polygon, np.arange(8), np.array([0, 8]))
    a, b, c = (polygon[triangles[:, i]] for i in range(3))
    assert np.cross(b - a, c - a)[:, 2].min() > 0.1
