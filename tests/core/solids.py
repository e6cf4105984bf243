# SPDX-License-Identifier: GPL-3.0-or-later
"""Convex solids, irregularly meshed and randomly rotated, so that only their shape reveals their rotations."""

from __future__ import annotations

import numpy as np
from creatures import Creature, directions
from scipy.spatial import ConvexHull, cKDTree

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import outward_hull

GOLDEN = (1 + 5**0.5) / 2
CUBE = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
TETRAHEDRON = CUBE[CUBE.prod(axis=1) > 0]
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
ICOSAHEDRON = np.array(
    [np.roll([0, a, b], shift) for a in (-1.0, 1.0) for b in (-GOLDEN, GOLDEN) for shift in range(3)]
)


def prism(sides: int, height: float = 1.0) -> np.ndarray:
    """(2 sides, 3) corners, on a circle of radius 1."""
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    return np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-height / 2, height / 2)])


def pyramid(sides: int, height: float = 2.0) -> np.ndarray:
    """(sides + 1, 3) corners: a base polygon on a circle of radius 1, and the apex."""
    return np.vstack([prism(sides)[:sides], [[0, 0, height - 0.5]]])


def solid(corners: np.ndarray, count: int = 900, seed: int = 0, nose: float = 0.0) -> Creature:
    """The convex hull of corners (c, 3) about the origin; each seed gives another mesh and rotation.

    The directions of the result are those before the rotation.

    Args:
        corners: corners of the solid in any order.
        count: approximate number of vertices.
        seed: seed of the mesh and of its rotation.
        nose: height of a bump beside the centre of a face, which removes all symmetry.
    """
    tips = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    where = directions(count, seed)
    where = np.vstack([tips, where[cKDTree(tips).query(where)[0] > 1.2 / count**0.5]])
    planes = ConvexHull(corners).equations
    radius = 1 / (where @ (planes[:, :3] / -planes[:, 3:]).T).max(axis=1)
    beside = planes[0, :3] + 0.4 * np.roll(planes[0, :3], 1) + 0.2 * np.roll(planes[0, :3], 2)
    radius += nose * np.exp(12 * (where @ (beside / np.linalg.norm(beside)) - 1))
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    return Creature(Surface(where * radius[:, None] @ (turn * np.linalg.det(turn)), outward_hull(where)), where)
