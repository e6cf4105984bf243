# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangulate polygons."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.ear_clipping import clip_ears

# A triangle of less than this share of its face's area is degenerate up to rounding.
NO_AREA = 1e-12
# Corners of the largest face that may become a fan. The triangles of a fan meet at one vertex, where searches compare
# all pairs of them: a fan of 10,000 corners made a match take 60 s and 3.3 GB. Ears, shortest cut first, share the
# corners out, and take 40 microseconds each.
MAX_FAN = 256


def triangulate(vertices: Floats, corner_vertex: Integers, face_start: Integers) -> Integers:
    """(m, 3) corner numbers: quads are cut along a diagonal without folds, larger faces into fans or ears."""
    sizes = np.diff(face_start)
    if (sizes == 3).all():
        return np.arange(len(corner_vertex)).reshape(-1, 3)
    parts = [face_start[:-1][sizes == 3, None] + np.arange(3)]
    faces = [np.flatnonzero(sizes == 3)]
    for size in np.unique(sizes[sizes > 3]):
        chosen = np.flatnonzero(sizes == size)
        corners = face_start[chosen, None] + np.arange(size)
        points = vertices[corner_vertex[corners]]
        points = points - points[:, :1]  # far from the origin, products would lose digits
        normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell
        order = _fan(size)
        if size == 4:
            convex = _agrees(points, order, normal)
            other = np.array([[1, 2, 3], [1, 3, 0]])
            convex |= ~_agrees(points, other, normal)  # neither diagonal is better: keep the first
            triangles = np.where(convex[:, None, None], corners[:, order], corners[:, other])
        else:
            triangles = corners[:, order]
            fans = _agrees(points, order, normal, NO_AREA) if size <= MAX_FAN else np.zeros(len(chosen), dtype=bool)
            for i in np.flatnonzero(~fans):
                triangles[i] = corners[i][clip_ears(points[i], normal[i])]
        parts.append(triangles.reshape(-1, 3))
        faces.append(np.repeat(chosen, size - 2))
    return np.concatenate(parts)[np.argsort(np.concatenate(faces), kind="stable")]


def _fan(size: int) -> Integers:
    return np.stack([np.zeros(size - 2, dtype=int), np.arange(1, size - 1), np.arange(2, size)], axis=1)


def _agrees(points: Floats, triangles: Integers, normal: Floats, least: float = 0) -> Booleans:
    """(f,) whether all triangles of a face (f, size, 3) wind like the face, with at least a share of its area."""
    a, b, c = (points[:, triangles[:, i]] for i in range(3))
    share = np.einsum("ftx,fx->ft", np.cross(b - a, c - a), normal)
    return np.asarray((share >= least * np.einsum("fx,fx->f", normal, normal)[:, None]).all(axis=1))
