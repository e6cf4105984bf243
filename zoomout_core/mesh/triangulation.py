"""Polygons cut into triangles."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers


def triangulate(vertices: Floats, corner_vertex: Integers, face_start: Integers) -> Integers:
    """(m, 3) corner numbers: quads along the diagonal that folds nothing, larger faces by fans or ears."""
    sizes = np.diff(face_start)
    if (sizes == 3).all():
        return np.arange(len(corner_vertex)).reshape(-1, 3)
    parts = [face_start[:-1][sizes == 3, None] + np.arange(3)]
    faces = [np.flatnonzero(sizes == 3)]
    for size in np.unique(sizes[sizes > 3]):
        chosen = np.flatnonzero(sizes == size)
        corners = face_start[chosen, None] + np.arange(size)
        points = vertices[corner_vertex[corners]]
        normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell
        order = _fan(size)
        convex = _agrees(points, order, normal)
        if size == 4:
            other = np.array([[1, 2, 3], [1, 3, 0]])
            convex |= ~_agrees(points, other, normal)  # neither diagonal is better: keep the first
            triangles = np.where(convex[:, None, None], corners[:, order], corners[:, other])
        else:
            triangles = corners[:, order]
            for i in np.flatnonzero(~convex):
                triangles[i] = corners[i][_ears(points[i], normal[i])]
        parts.append(triangles.reshape(-1, 3))
        faces.append(np.repeat(chosen, size - 2))
    return np.concatenate(parts)[np.argsort(np.concatenate(faces), kind="stable")]


def _fan(size: int) -> Integers:
    return np.stack([np.zeros(size - 2, dtype=int), np.arange(1, size - 1), np.arange(2, size)], axis=1)


def _agrees(points: Floats, triangles: Integers, normal: Floats) -> Booleans:
    """(f,) whether all triangles of a face (f, size, 3) wind like the face itself."""
    a, b, c = (points[:, triangles[:, i]] for i in range(3))
    return np.asarray((np.einsum("ftx,fx->ft", np.cross(b - a, c - a), normal) >= 0).all(axis=1))


def _ears(points: Floats, normal: Floats) -> Integers:
    """(size - 2, 3) a triangulation of one polygon (size, 3) by ear clipping."""
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, axis, axis=1)
    flat[:, 0] *= np.sign(normal[axis])  # seen from the side that the normal points to
    if axis == 1:  # dropping y leaves (x, z), a left-handed plane
        flat = flat[:, ::-1]

    def cross(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))

    left = list(range(len(points)))
    triangles = []
    while len(left) > 3:
        ears = []
        for i in range(len(left)):
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            others = [p for p in left if p not in (a, b, c)]
            inside = any(
                cross(a, b, p) >= 0 and cross(b, c, p) >= 0 and cross(c, a, p) >= 0 and cross(a, b, c) > 0
                for p in others
            )
            ears.append(-np.inf if inside else cross(a, b, c))
        i = int(np.argmax(ears))
        triangles.append((left[i - 1], left[i], left[(i + 1) % len(left)]))
        del left[i]
    return np.array([*triangles, tuple(left)])
