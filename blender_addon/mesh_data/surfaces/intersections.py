# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles that intersect each other, by Blender's trees of bounding volumes."""

from __future__ import annotations

import numpy as np
from mathutils.bvhtree import BVHTree

from zoomout_core.arrays import Floats, Integers


def intersecting_triangles(points: Floats, triangles: Integers, chosen: Integers, others: Integers) -> Integers:
    """Pairs (p, 2) of triangles that intersect, each once: two chosen ones, or a chosen one and one of the others.

    Neighbours are among them where they are folded onto each other, and where a chosen one borders on another one.

    Args:
        points: (n, 3) positions.
        triangles: (m, 3) vertex numbers.
        chosen: (c,) numbers of triangles, ascending.
        others: (o,) numbers of other triangles.
    """
    tree = _tree(points, triangles[chosen])
    own = _pairs(tree, tree)
    across = _pairs(tree, _tree(points, triangles[others]))
    own = own[own[:, 0] < own[:, 1]]
    return np.vstack([chosen[own], np.column_stack([chosen[across[:, 0]], others[across[:, 1]]])])


def _tree(points: Floats, triangles: Integers) -> BVHTree:
    used = np.zeros(len(points), dtype=bool)
    used[triangles] = True
    number = np.cumsum(used) - 1
    return BVHTree.FromPolygons(points[used].tolist(), number[triangles].tolist(), all_triangles=True)


def _pairs(one: BVHTree, other: BVHTree) -> Integers:
    return np.array(one.overlap(other), dtype=np.int64).reshape(-1, 2)
