# SPDX-License-Identifier: GPL-3.0-or-later
"""Diagonals of quads, flipped so that a mesh with a plane of symmetry has symmetric edges."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.adjacency import Edges, Quads
from zoomout_core.mesh.triangles import signed_areas


def flip_diagonals(
    triangles: Integers, corners: Integers, wedge: Integers, mirror: Integers, places: Floats, uv: Floats | None
) -> Integers:
    """(m, 3) the corners of triangles after diagonals of quads are flipped where the mirror image has the other one.

    Programs divide quads alike on both sides, instead of symmetrically. The longer of the two diagonals is flipped.

    Args:
        triangles: (m, 3) vertex numbers.
        corners: (m, 3) numbers of the corners.
        wedge: (c,) the data of all corners, which differs across seams; these are not flipped.
        mirror: (n,) the mirror image of each vertex, -1 for none.
        places: (n, 3) positions of the vertices.
        uv: (c, 2) texture coordinates of all corners, whose triangles are not turned over; None if there are none.
    """
    edges = Edges(triangles, wedge[corners], len(places))
    quads = Quads(triangles, edges)
    image = mirror[quads.vertices]
    paired = np.flatnonzero((image >= 0).all(axis=1))
    image = image[paired]
    other = edges.find(image[:, 1], image[:, 3])
    missing = (edges.find(image[:, 0], image[:, 2]) < 0) & (other >= 0)
    one, other = paired[missing], quads.of_edge[other[missing]]
    there = np.sort(quads.vertices[other][:, 1::2], axis=1)
    same = (other >= 0) & (one < other) & (there == np.sort(image[missing][:, ::2], axis=1)).all(axis=1)
    one, other = one[same], other[same]
    ends = places[quads.vertices[:, ::2]]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    flipped = np.where(length[one] > length[other], one, other)
    flipped = flipped[quads.touch_once(flipped, len(triangles))]
    first, second = quads.triangles[flipped].T
    a, b, c, d = (quads.corners_of(corners, flipped)[:, place] for place in range(4))
    if uv is not None:
        areas = [signed_areas(uv[np.stack(each, axis=1)]) for each in ((a, b, d), (b, c, d))]
        before = signed_areas(uv[np.stack((a, c, d), axis=1)])
        kept = (areas[0] * before > 0) & (areas[1] * before > 0)
        first, second, a, b, c, d = (each[kept] for each in (first, second, a, b, c, d))
    made = corners.copy()
    made[first] = np.stack((a, b, d), axis=1)
    made[second] = np.stack((b, c, d), axis=1)
    return made
