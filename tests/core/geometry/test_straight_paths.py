# SPDX-License-Identifier: GPL-3.0-or-later
"""Points follow straight paths over a mesh, around bends and not across gaps."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.straight_paths import follow_paths
from zoomout_core.samples.grids import grid, grid_faces, triangles_of

SIZE = 12
TRIANGLES = triangles_of(grid_faces(SIZE, SIZE))
FLAT = grid(np.linspace(0, 1, SIZE + 1), np.linspace(0, 1, SIZE + 1)).vertices
RANDOM = np.random.default_rng(0)
STARTS = RANDOM.uniform(0.3, 0.5, (40, 2))
STEPS = RANDOM.uniform(-0.25, 0.45, (40, 2))


def flat(points: np.ndarray) -> np.ndarray:
    """(q, 3) points (q, 2) of the unit square, in space."""
    return np.column_stack([points, np.zeros(len(points))])


def ends(vertices: np.ndarray, triangles: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(q, 3) ends of paths over a bent square that start at the places of `STARTS` on the flat one."""
    triangle, barycentric = closest_points(flat(STARTS), FLAT, triangles)
    triangle, barycentric = follow_paths(vertices, triangles, triangle, barycentric, steps)
    assert (barycentric >= 0).all()
    np.testing.assert_allclose(barycentric.sum(axis=1), 1)
    return np.einsum("qc,qcx->qx", barycentric, vertices[triangles[triangle]])


def test_paths_in_a_plane_are_straight_and_ignore_normal_steps() -> None:
    steps = flat(STEPS)
    steps[:, 2] = RANDOM.uniform(-1, 1, len(steps))
    np.testing.assert_allclose(ends(FLAT, TRIANGLES, steps), flat(STARTS + STEPS), atol=1e-12)


def test_steps_of_subnormal_length_stay_without_a_warning() -> None:
    np.testing.assert_allclose(ends(FLAT, TRIANGLES, flat(np.full_like(STEPS, 1e-312))), flat(STARTS), atol=1e-12)


@pytest.mark.parametrize("angle", [0.5, 2.0, 3.1])
@pytest.mark.parametrize("mixed", [False, True])
def test_paths_unfold_over_creases_with_any_winding(angle: float, mixed: bool) -> None:
    triangles = TRIANGLES.copy()
    if mixed:
        triangles[::3] = triangles[::3, ::-1]

    def folded(points: np.ndarray) -> np.ndarray:
        """Points in the plane, folded about the line x = 1/2."""
        beyond = np.maximum(points[:, 0] - 0.5, 0)
        x = points[:, 0] - beyond * (1 - np.cos(angle))
        return np.column_stack([x, points[:, 1], np.sin(angle) * beyond])

    found = ends(folded(FLAT), triangles, flat(STEPS))
    np.testing.assert_allclose(found, folded(flat(STARTS + STEPS)), atol=1e-12)


def test_paths_leave_a_vertex_in_every_direction() -> None:
    middle = np.flatnonzero(np.isclose(FLAT, [0.5, 0.5, 0]).all(axis=1))
    angle = np.linspace(0, 2 * np.pi, 33)
    steps = flat(0.3 * np.column_stack([np.cos(angle), np.sin(angle)]))
    for triangle, corner in np.argwhere(middle == TRIANGLES):
        start = np.full(len(angle), triangle), np.tile(np.eye(3)[corner], (len(angle), 1))
        triangles, barycentric = follow_paths(FLAT, TRIANGLES, *start, steps)
        found = np.einsum("qc,qcx->qx", barycentric, FLAT[TRIANGLES[triangles]])
        np.testing.assert_allclose(found, FLAT[middle] + steps, atol=1e-12)


def test_paths_slide_along_borders() -> None:
    found = ends(FLAT, TRIANGLES, flat(np.tile([2.0, 0.3], (40, 1))))
    np.testing.assert_allclose(found, flat(np.column_stack([np.ones(40), STARTS[:, 1] + 0.3])), atol=1e-12)
    found = ends(FLAT, TRIANGLES, flat(np.tile([2.0, -3.0], (40, 1))))
    np.testing.assert_allclose(found, flat(np.tile([1.0, 0.0], (40, 1))), atol=1e-12)
