# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a source that a map reaches: all but what is hidden on the target, such as a body below clothes."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Indices, Integers
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.mapped_target import MappedTarget


class ReachedSurface:
    """Closest points of a source at rest, on the places of each of its loose parts that are near images on that part.

    A target that is one skin shows clothes, and not the body below them. The closest point of a shirt may be on the
    chest below it all the same, as errors of a pose are larger than the gap.
    """

    def __init__(self, rest: Surface, mapped: MappedTarget, reach: float) -> None:
        """Prepare the search.

        Args:
            rest: the source at rest.
            mapped: a target over the source, with the map whose images count.
            reach: distance from an image up to which places are reached, in the source's unit.
        """
        self._number = _reached_triangles(rest, mapped, reach)
        self._search = SurfaceSearch(rest.vertices, rest.triangles[self._number])

    def closest(self, points: Floats) -> tuple[Integers, Floats]:
        """The triangles (q,) of the source and barycentric coordinates (q, 3) closest to points (q, 3)."""
        triangle, barycentric = self._search.closest(points)
        return self._number[triangle], barycentric


def _reached_triangles(rest: Surface, mapped: MappedTarget, reach: float) -> Indices:
    """The numbers of the triangles that are reached."""
    part = rest.components[rest.triangles[:, 0]]
    if part.max(initial=0) == 0:
        return np.arange(len(part))
    images, of_image = mapped.surface_map.interpolate(rest.vertices), part[mapped.surface_map.triangle]
    reached = np.zeros(len(part), dtype=bool)
    for number in np.unique(of_image):
        own = np.flatnonzero(part == number)
        corners = rest.vertices[rest.triangles[own]]
        near = np.asarray(cKDTree(images[of_image == number]).query(corners)[0])
        reached[own] = near.min(axis=1) <= reach
    reached[mapped.surface_map.triangle] = True
    return np.flatnonzero(reached)
