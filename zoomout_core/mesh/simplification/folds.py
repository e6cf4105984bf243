# SPDX-License-Identifier: GPL-3.0-or-later
"""Folds that collapses would make: triangles that come to lie on a neighbour."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.adjacency import Edges

# Smallest opening between triangles with a common edge that a collapse may make: one plus the cosine between their
# normals, 0 where they are folded onto each other. 0.2 is an angle of 37 degrees inside a solid.
MIN_OPENING = 0.2
# Where the mesh is folded more sharply, the share of the smallest opening at a vertex that its collapse keeps.
KEPT_OPENING = 0.5
# The opening between triangles of a plane.
FLAT_OPENING = 2.0


class MovedTriangles(NamedTuple):
    """Triangles that collapses move and keep; each is at the tail of one collapse only."""

    which: Integers  # (q,) the number of the collapse
    triangle: Integers  # (q,) the number of the triangle
    normals: Floats  # (q, 3) its unit normal after the collapse, at rest


def find_folds(
    tail: Integers, head: Integers, moved: MovedTriangles, triangles: Integers, normals: Floats, edges: Edges
) -> Booleans:
    """(q,) whether collapses fold triangles onto a neighbour, clearly more than any at the same tail was before.

    Args:
        tail: (k,) the vertices that are merged.
        head: (k,) the vertices that they are merged into.
        moved: the triangles at the tails that stay.
        triangles: (m, 3) all triangles.
        normals: (m, 3) their unit normals before the collapses, at rest.
        edges: their edges.
    """
    which, triangle, _ = moved
    beyond = edges.across[triangle]
    rows = triangles[beyond]
    at_tail = rows == tail[which, None, None]
    removed = at_tail.any(axis=2) & (rows == head[which, None, None]).any(axis=2) & (beyond >= 0)
    # The neighbour beyond a removed triangle is that across its side opposite the tail.
    beyond = np.where(removed, edges.across[beyond, (at_tail.argmax(axis=2) + 1) % 3], beyond)
    after = normals.copy()
    after[triangle] = moved.normals
    opening = _openings(after, triangle, beyond)
    before = np.full(len(tail), FLAT_OPENING)
    np.minimum.at(before, which, _openings(normals, triangle, edges.across[triangle]))
    return (opening < MIN_OPENING) & (opening < KEPT_OPENING * before[which])


def _openings(normals: Floats, triangle: Integers, beyond: Integers) -> Floats:
    """(q,) the smallest opening between triangles (q,) and their neighbours (q, 3), -1 for none, see `MIN_OPENING`."""
    opening = 1 + np.einsum("qx,qsx->qs", normals[triangle], normals[beyond])
    return np.asarray(np.where(beyond < 0, FLAT_OPENING, opening).min(axis=1))
