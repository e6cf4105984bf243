# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices that are one but for rounding are one in the working copy, and what lies twice is there once."""

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
    """Every triangle with corners of its own, moved by some tolerances."""
    points = VERTICES[TRIANGLES].reshape(-1, 3)
    away = np.random.default_rng(0).uniform(-1, 1, points.shape)
    points = points + jitter * DIAMETER * welding.TOLERANCE * away / np.linalg.norm(away, axis=1, keepdims=True)
    return Surface(points if frame is None else points @ frame.T, np.arange(len(points)).reshape(-1, 3))


@pytest.mark.parametrize("seed", range(3))
def test_corners_within_the_tolerance_are_one_in_whatever_frame(seed: int) -> None:
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    working = soup(0.45, turn).working
    assert len(working.vertices) == len(VERTICES)
    assert working.component.max() == 0
    expected = soup(0.45).working
    np.testing.assert_array_equal(working.vertex_of, expected.vertex_of)
    assert len(soup(20.0).working.vertices) > 2 * len(VERTICES)


def test_what_others_connect_is_one() -> None:
    """A row of vertices, each within the tolerance of the next."""
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
def test_what_lies_twice_is_there_once(name: str, jitter: float) -> None:
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


def test_a_surface_may_touch_itself_off_its_borders() -> None:
    """Two closed shapes that share a place of one vertex, and a copy that has moved."""
    shift = VERTICES[0] - VERTICES[1]
    both = Surface(np.concatenate([VERTICES, VERTICES + shift]), np.concatenate([TRIANGLES, TRIANGLES + len(VERTICES)]))
    assert len(both.working.vertices) == 2 * len(VERTICES)
    assert len(both.working.triangles) == 2 * len(TRIANGLES)


def test_a_fold_of_two_triangles_stays() -> None:
    """They lie on one another, but are of one closed surface, which would be torn."""
    tetrahedron = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    # The face 0 2 1 is cut into a fold along 0 1, whose far corners 2 and 4 are in one place, and what it hides.
    folded = Surface([*tetrahedron, tetrahedron[2]], [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 4, 1], [1, 4, 2], [2, 4, 0]])
    assert len(folded.working.vertices) == 5
    # And so it is where the corners are one, as decimation leaves it: a fin on the edge from 0 to 1.
    closed = [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]]
    fin = Surface([*tetrahedron, [1, 1, -1]], [*closed, [0, 1, 4], [0, 4, 1]])
    assert len(fin.working.triangles) == 6
    # What turns the same way twice is no fold.
    assert len(Surface(tetrahedron, [*closed, closed[0]]).working.triangles) == 4


def test_a_shape_within_the_tolerance_of_a_far_triangle_takes_no_time() -> None:
    far = 1e9 * np.array([[1.0, 0, 0], [1, 1, 0], [0, 1, 1]])
    grid: Integers = np.arange(3 * 20_000).reshape(-1, 3)
    points = np.random.default_rng(0).random((3 * 20_000, 3))
    working = Surface(np.concatenate([points, far]), np.concatenate([grid, [[60_000, 60_001, 60_002]]])).working
    assert len(working.triangles) == 1
