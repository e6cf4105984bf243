# SPDX-License-Identifier: GPL-3.0-or-later
"""The working copy welds vertices that differ by rounding, and drops duplicate faces."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh import welding
from zoomout_core.mesh.surface import Surface

SURFACE = creature(600).surface
VERTICES, TRIANGLES = SURFACE.vertices, SURFACE.triangles
DIAMETER = 2 * float(np.linalg.norm(VERTICES - VERTICES.mean(axis=0), axis=1).max())


def soup(jitter: float, frame: Floats | None = None) -> Surface:
    """The mesh with separate corners for every triangle, displaced by `jitter` tolerances."""
    points = VERTICES[TRIANGLES].reshape(-1, 3)
    away = np.random.default_rng(0).uniform(-1, 1, points.shape)
    points = points + jitter * DIAMETER * welding.TOLERANCE * away / np.linalg.norm(away, axis=1, keepdims=True)
    return Surface(points if frame is None else points @ frame.T, np.arange(len(points)).reshape(-1, 3))


@pytest.mark.parametrize("seed", range(3))
def test_corners_within_tolerance_are_welded_in_any_frame(seed: int) -> None:
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    working = soup(0.45, turn).working
    assert len(working.vertices) == len(VERTICES)
    assert working.component.max() == 0
    expected = soup(0.45).working
    np.testing.assert_array_equal(working.vertex_of, expected.vertex_of)
    assert len(soup(20.0).working.vertices) > 2 * len(VERTICES)


def test_vertices_chained_within_tolerance_are_welded() -> None:
    """A row of vertices, each within tolerance of the next, is welded into one."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    step = 0.9 * 2 * np.linalg.norm(square - square.mean(axis=0), axis=1).max() * welding.TOLERANCE
    along = np.array([step, 0, 0])
    points = np.concatenate([square + number * along for number in range(4)])
    apart = np.concatenate([square, square + 4 * along])
    turned = np.arange(12).reshape(-1, 3)[:, [0, 2, 1]]
    assert len(Surface(points, turned).working.vertices) == 3
    assert len(Surface(apart, turned[:2]).working.vertices) == 6


DOUBLED = {
    "each face twice": (1, (TRIANGLES, TRIANGLES)),
    "each face from both sides": (1, (TRIANGLES, TRIANGLES[:, ::-1])),
    "a copy": (2, (TRIANGLES, TRIANGLES + len(VERTICES))),
    "a copy inside out": (2, (TRIANGLES, TRIANGLES[:, [1, 0, 2]] + len(VERTICES))),
    "three times": (1, (TRIANGLES[:, [2, 0, 1]], TRIANGLES, TRIANGLES)),
    "a part from both sides": (1, (TRIANGLES, TRIANGLES[:100, ::-1])),
}


@pytest.mark.parametrize("name", DOUBLED)
@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_duplicate_faces_are_dropped(name: str, jitter: float) -> None:
    copies, faces = DOUBLED[name]
    away = jitter * DIAMETER * welding.TOLERANCE * np.random.default_rng(0).uniform(-1, 1, (copies, *VERTICES.shape))
    away[0] = 0
    working = Surface((VERTICES + away).reshape(-1, 3), np.concatenate(faces)).working
    once = SURFACE.working
    np.testing.assert_allclose(working.vertices, once.vertices, atol=1e-9)
    np.testing.assert_array_equal(np.sort(working.triangles, axis=1), np.sort(once.triangles, axis=1))
    np.testing.assert_array_equal(working.triangle_of, np.arange(len(TRIANGLES)))
    np.testing.assert_array_equal(working.vertex_of, np.tile(once.vertex_of, copies))
    assert working.scale == pytest.approx(once.scale)


def test_surfaces_that_touch_off_their_borders_stay_separate() -> None:
    """Two closed shapes with one vertex in the same place stay separate."""
    shift = VERTICES[0] - VERTICES[1]
    both = Surface(np.concatenate([VERTICES, VERTICES + shift]), np.concatenate([TRIANGLES, TRIANGLES + len(VERTICES)]))
    assert len(both.working.vertices) == 2 * len(VERTICES)
    assert len(both.working.triangles) == 2 * len(TRIANGLES)


def test_folds_and_fins_of_two_triangles_are_kept() -> None:
    """The two coincide, but removing them would tear a closed surface."""
    tetrahedron = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    # Vertex 4 coincides with vertex 2; the face 0 2 1 is replaced by 0 4 1 and two faces of zero area.
    folded = Surface([*tetrahedron, tetrahedron[2]], [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 4, 1], [1, 4, 2], [2, 4, 0]])
    assert len(folded.working.vertices) == 5
    # A fin on the edge from 0 to 1, as decimation leaves it, also stays.
    closed = [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]]
    fin = Surface([*tetrahedron, [1, 1, -1]], [*closed, [0, 1, 4], [0, 4, 1]])
    assert len(fin.working.triangles) == 6
    # Two faces with the same winding are duplicates, not a fold.
    assert len(Surface(tetrahedron, [*closed, closed[0]]).working.triangles) == 4


def test_shape_below_the_tolerance_of_a_far_triangle_is_welded() -> None:
    far = 1e9 * np.array([[1.0, 0, 0], [1, 1, 0], [0, 1, 1]])
    grid: Integers = np.arange(3 * 20_000).reshape(-1, 3)
    points = np.random.default_rng(0).random((3 * 20_000, 3))
    working = Surface(np.concatenate([points, far]), np.concatenate([grid, [[60_000, 60_001, 60_002]]])).working
    assert len(working.triangles) == 1
