# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect surfaces that overlap in space, such as characters of one pack in the same pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair, target_in_space
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.tuning import Tuning, tuned

# Samples of a surface of many shells: some percent of its area get dozens.
OVERLAP_POINTS = 2000


@dataclass(frozen=True)
class OverlapTuning(Tuning, set_by="characters"):
    """When two surfaces overlap, and when a map leaves the target in place."""

    near: float = tuned(0.05, "longest extents", 0, 1)  # maximum distance at which points overlap
    # Maximum part of a surface's area that does not overlap: it is at most 0.05 on pairs in one pose, and at least
    # 0.18 on all others.
    max_elsewhere: float = tuned(0.06, "1", 0, 1)
    # A target that is nearer than this to the source overlaps it even if the source has more: it is a piece in place.
    lies_on: float = tuned(0.01, "longest extents", 0, 1)
    stays: float = tuned(0.1, "at unit area", 0, 1)  # a map leaves points in place that it moves by less than this
    mostly: float = tuned(0.85, "1", 0, 1)  # a map that leaves more of the area in place leaves all of it in place
    # A head that looks aside hardly leaves its place, but its surface turns. On six pairs in one pose no surroundings
    # are rotated by more than `rotated`. If heads turn by 30 to 50 degrees, .078 to .131 of the area is on five pairs,
    # and .009 at most on two whose heads are like balls.
    rotated: float = tuned(20.0, "degrees", 0, 180)
    max_rotated: float = tuned(0.03, "1", 0, 1)  # maximum part of the area of a map that leaves the target in place


OVERLAP = OverlapTuning()


class _Outline(NamedTuple):
    """A shape by the points that are tested for an overlap, and the triangles that others are tested against."""

    points: Floats  # (s, 3)
    areas: Floats  # (s,) that they represent
    vertices: Floats  # (n, 3)
    triangles: Integers  # (m, 3)

    def is_near(self, other: _Outline, distance: float) -> bool:
        """Whether nearly all of its area is nearer to another shape than a distance."""
        found = SurfaceMap(*closest_points(self.points, other.vertices, other.triangles, distance), other.triangles)
        elsewhere = np.linalg.norm(found.interpolate(other.vertices) - self.points, axis=1) > distance
        return bool(self.areas[elsewhere].sum() <= OVERLAP.max_elsewhere * self.areas.sum())


def overlapping(pair: Pair) -> Floats | None:
    """(n_t, 3) the target shape's vertices where they are in space, in the source part's frame, if the two overlap.

    Nearly all of both surfaces is near the other one then, or the target coincides with a part of the source, which may
    have more. Hulls stand for their whole surfaces, because they lack pieces that are too far away to be joined.
    """
    source, target = pair.source_shape, pair.target_shape
    here, there = target_in_space(pair)[target.proxy.full_vertex], source.proxy.vertices
    if target.proxy.full.is_hull:
        ours, theirs = (_outline_of_surface(surface, source.proxy.full) for surface in (pair.target, pair.source))
    else:
        ours, theirs = (
            _Outline(places, shape.basis.areas, places, shape.proxy.mesh.triangles)
            for shape, places in ((target, here), (source, there))
        )
    extent = max(float(np.ptp(places, axis=0).max()) for places in (here, there))
    near, on = OVERLAP.near * extent, OVERLAP.lies_on * extent
    overlap = ours.is_near(theirs, near) and (theirs.is_near(ours, near) or ours.is_near(theirs, on))
    return here if overlap else None


def _outline_of_surface(surface: Surface, frame: WorkingMesh) -> _Outline:
    """All of a surface, in the frame of a part."""
    mesh = surface.working
    vertices = frame.from_surface(mesh.to_surface(mesh.vertices))
    points, _ = surface_samples(vertices, mesh.triangles, OVERLAP_POINTS)
    return _Outline(points, np.ones(len(points)), vertices, mesh.triangles)


def leaves_in_place(images: Floats, places: Floats, areas: Floats, rotations: Floats) -> bool:
    """Whether a map from places (n, 3), of areas (n,), to images (n, 3) is the identity in space, up to its errors.

    Its `rotations` (n, 3, 3), those of the surroundings of each place, show parts that turn in place, such as a head.
    """
    stays = np.linalg.norm(images - places, axis=1) < OVERLAP.stays
    if areas[stays].sum() <= OVERLAP.mostly * areas.sum():
        return False
    cosine = (np.trace(rotations, axis1=1, axis2=2) - 1) / 2
    turned = cosine < np.cos(np.radians(OVERLAP.rotated))
    return bool(areas[turned].sum() <= OVERLAP.max_rotated * areas.sum())
