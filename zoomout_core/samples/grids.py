# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of quads, flat or closed around one axis or two."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import Surface


def grid(u: Floats, v: Floats) -> Surface:
    """The flat grid of quads on the points (u, v, 0) for each u (n,) and v (m,); v varies first."""
    points = np.stack(np.meshgrid(u, v, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    return Surface(points, grid_faces(len(u) - 1, len(v) - 1))


def grid_faces(columns: int, rows: int, closed: tuple[bool, bool] = (False, False)) -> Integers:
    """(columns * rows, 4) vertices of a grid's quads, wound from direction i to direction j.

    Args:
        columns: cells along i.
        rows: cells along j; the vertices of each column follow each other.
        closed: whether the last cells along i, and along j, connect to the first vertices.
    """
    across, lines = (count + (not around) for count, around in zip((columns, rows), closed, strict=True))
    i, j = np.indices((columns, rows)).reshape(2, -1, 1)
    right, up = np.array([[0, 1, 1, 0], [0, 0, 1, 1]])
    return (i + right) % across * lines + (j + up) % lines


def ring_faces(rings: int, around: int, closed: bool = False) -> Integers:
    """(f, 4) vertices of the quads between rings of vertices, wound outwards if these go up, counterclockwise.

    Each ring has `around` vertices; the last one may connect to the first (`closed`).
    """
    return grid_faces(rings - (not closed), around, (closed, True))[:, [0, 3, 2, 1]]


def triangles_of(quads: Integers) -> Integers:
    """(2 m, 3) halves of quads (m, 4) cut from the first to the third corner; all halves before the cut come first."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
