# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on the sphere, and meshes over them: every seed is another mesh of the same surface."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import Surface

Place = tuple[float, float, float]


def directions(count: int, seed: int) -> Floats:
    """(count, 3) irregular but even points on the sphere."""
    i = np.arange(count) + 0.5
    height, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    ring = np.sqrt(1 - height**2)
    points = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    random = np.random.default_rng(seed)
    points = points @ np.linalg.qr(random.standard_normal((3, 3)))[0]
    points += random.normal(scale=0.25 / np.sqrt(count), size=points.shape)
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def outward_hull(points: Floats) -> Integers:
    """(m, 3) triangles of the convex hull of points (n, 3) around the origin, wound outwards."""
    triangles = ConvexHull(points).simplices
    a, b, c = (points[triangles[:, i]] for i in range(3))
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) > 0
    return np.where(outward[:, None], triangles, triangles[:, ::-1])


def ball(radius: float, centre: Place = (0, 0, 0), radii: Place = (1, 1, 1), count: int = 60, seed: int = 0) -> Surface:
    """An ellipsoid of irregular but even triangles, with half axes `radius * radii`; every seed is another mesh."""
    where = directions(count, seed)
    return Surface(radius * where * radii + np.array(centre), outward_hull(where))
