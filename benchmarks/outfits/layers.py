# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of a worn object: loose parts over each other, such as a belt over a top."""

from __future__ import annotations

from itertools import permutations
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, components, unique_edges
from zoomout_core.transfer.dressing.barriers import SidedSurface

# A part is a layer if it has this many triangles: smaller ones are buttons and eyelets.
TRIANGLES = 100
# Vertices between these distances above another part, in centimetres, are on it; below the first one both are sewn
# together. They are in it if they are deeper than the last one.
SEWN, NEAR, DEEP = 0.05, 2.5, 0.1
# Fewer vertices above a part are ends of seams.
FEW = 15


class _Pair(NamedTuple):
    """Vertices of one part above another one."""

    above: Integers  # (v,) numbers of the vertices
    lower: Integers  # (m, 3) triangles of the part below, wound away from the skin
    height: Floats  # (v,) their original height, in centimetres


class Layers:
    """The layers of a thing on a body, with a length of a centimetre."""

    def __init__(self, thing: Surface, body: Surface, centimetre: float) -> None:
        self._centimetre = centimetre
        edges, _ = unique_edges(thing.triangles)
        part = components(edges, len(thing.vertices))
        triangles = _wind_away(thing, part, SidedSurface.of(body, 1.0))
        of_part = part[triangles[:, 0]]
        large = np.flatnonzero(np.bincount(of_part) >= TRIANGLES)
        self._pairs = list[_Pair]()
        for upper, lower in permutations(large.tolist(), 2):
            below, vertices = triangles[of_part == lower], np.flatnonzero(part == upper)
            height, known = self._heights(thing.vertices, below, vertices)
            above = known & (height > SEWN) & (height < NEAR)
            if above.sum() >= FEW:
                self._pairs.append(_Pair(vertices[above], below, height[above]))

    def figures(self, found: Floats) -> dict[str, float]:
        """The figures of vertices (n, 3); nothing for a thing without layers.

        `in layer`: percentage of vertices above a layer that are now in it. `layer change`: median change of their
        height above it, in centimetres.
        """
        if not self._pairs:
            return {}
        wrong, change = list[Booleans](), list[Floats]()
        for pair in self._pairs:
            height, known = self._heights(found, pair.lower, pair.above)
            wrong.append(known & (height < -DEEP))
            change.append(np.abs(height - pair.height)[known])
        return {
            "in layer": 100 * float(np.concatenate(wrong).mean()),
            "layer change": float(np.median(np.concatenate(change))),
        }

    def _heights(self, points: Floats, lower: Integers, vertices: Integers) -> tuple[Floats, Booleans]:
        """(v,) heights of vertices above a part, in centimetres, and which are not beside its border."""
        height, _, known = SidedSurface(points, lower).sides(points[vertices])
        return height / self._centimetre, known


def _wind_away(thing: Surface, part: Integers, skin: SidedSurface) -> Integers:
    """(m, 3) triangles, wound so that each part faces away from the skin."""
    corners = thing.triangles.copy()
    of_part = part[corners[:, 0]]
    normals = skin.sides(thing.vertices[corners].mean(axis=1))[1]
    facing = np.einsum("mx,mx->m", area_normals(thing.vertices, corners), normals)
    inward = (np.bincount(of_part, facing) < 0)[of_part]
    corners[inward] = corners[inward, ::-1]
    return corners
