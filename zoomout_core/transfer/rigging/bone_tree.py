# SPDX-License-Identifier: GPL-3.0-or-later
"""The spanning tree of bones that share vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.transfer.rigging.bone_problem import BoneProblem

# Shared weight of bones and parents without a common vertex: less than that of any bones with one.
MIN_SHARED = 1e-15


@dataclass(frozen=True, eq=False)
class BoneTree:
    """The spanning tree of the bones."""

    order: Integers  # (b,) bones outwards from the one that moves most, one tree after the other
    above: Integers  # (b,) the preceding bone of each in the tree, -1 for the first of a tree
    joint: Floats  # (b, 3) the point where each meets that bone


def bone_tree(fit: BoneProblem) -> BoneTree:
    """The spanning tree of the bones that share most vertices, or of bones and parents if they share none."""
    shared = fit.pairs[:, :, 3, 3].copy()
    np.fill_diagonal(shared, 0)
    parents = next_above(fit.all_parents, fit.moving, strictly=True)[fit.moving]
    child = np.flatnonzero(parents >= 0)
    hanging = shared.copy()
    hanging[child, parents[child]] += MIN_SHARED
    hanging = np.maximum(hanging, hanging.T)
    costs = np.divide(1, hanging, out=np.zeros_like(hanging), where=hanging > 0)
    edges = minimum_spanning_tree(csr_array(costs))
    order, above = list[int](), np.full(len(fit.mass), -1)
    for root in np.argsort(-fit.mass, kind="stable").tolist():
        if root not in order:
            found, before = breadth_first_order(edges, root, directed=False)
            order += found.tolist()
            above[found[1:]] = before[found[1:]]
    bone = np.arange(len(above))
    together = np.where((shared[bone, above] > 0) & (above >= 0), above, bone)  # otherwise the centroid of its vertices
    moments = fit.pairs[bone, together]
    joint = moments[:, :3, 3] / np.maximum(moments[:, 3, 3], SMALLEST)[:, None]
    return BoneTree(np.array(order), above, joint)


def next_above(parents: Integers, moving: Integers, strictly: bool = False) -> Integers:
    """(b,) the nearest of the moving bones from each bone upwards, numbered among these; -1 for none.

    With `strictly` the search begins at the bone's parent (b,), which is -1 for none.
    """
    number = np.full(len(parents) + 1, -1)
    number[moving] = np.arange(len(moving))
    above = parents.copy() if strictly else np.arange(len(parents))
    for _ in range(len(parents)):  # no chain is longer
        skipped = (above >= 0) & (number[above] < 0)
        if not skipped.any():
            break
        above[skipped] = parents[above[skipped]]
    return number[above]
