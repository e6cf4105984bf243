# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror images among the vertices of a mesh that was modelled symmetrically, as characters are."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers

# Distance of a mirror image from its vertex, relative to the extent, up to which they are a pair.
REACH = 1e-4
# Smallest share of the vertices with a mirror image.
MIN_SHARE = 0.9


def mirror_pairs(vertices: Floats) -> Integers | None:
    """(n,) the mirror image of each vertex (n, 3), itself on the plane, -1 for none; None without a plane of symmetry.

    The planes are those at right angles to an axis, through the middle of the mesh or the origin.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    reach = REACH * float((high - low).max())
    tree = cKDTree(vertices)
    best, most = None, MIN_SHARE * len(vertices)
    for axis in range(3):
        for middle in {0.0, float(low[axis] + high[axis]) / 2}:
            images = vertices.copy()
            images[:, axis] = 2 * middle - images[:, axis]
            _, found = tree.query(images, distance_upper_bound=reach)
            pairs = np.where(found < len(vertices), found, -1)
            pairs[pairs[pairs] != np.arange(len(pairs))] = -1
            if (count := int((pairs >= 0).sum())) > most:
                best, most = pairs, count
    return best


def mirror_moves(vertices: Floats, moved: Floats, pairs: Integers) -> Floats:
    """(n, 3) moved positions whose displacements are the same on both sides.

    Args:
        vertices: (n, 3) positions before.
        moved: (n, 3) positions after.
        pairs: (n,) mirror images before, see `mirror_pairs`.
    """
    has = np.flatnonzero(pairs >= 0)
    other = pairs[has]
    # The axis is that along which images differ in sum: on the others they agree.
    axis = int(np.abs(vertices[has] - vertices[other]).sum(axis=0).argmax())
    sign = np.ones(3)
    sign[axis] = -1
    step = moved - vertices
    even = moved.copy()
    even[has] = vertices[has] + (step[has] + sign * step[other]) / 2
    return even
