# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect surfaces that overlap in space, such as characters of one pack in the same pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair, standing
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class OverlapTuning(Tuning, set_by="characters"):
    """When two surfaces overlap, and when a map leaves the target in place."""

    near: float = tuned(0.05, "longest extents", 0, 1)  # maximum distance at which points overlap
    # Maximum part of either surface's area that does not overlap: it is at most 0.05 on pairs in one pose, and at least
    # 0.18 on all others.
    max_elsewhere: float = tuned(0.06, "1", 0, 1)
    stays: float = tuned(0.1, "at unit area", 0, 1)  # a map leaves points in place that it moves by less than this
    mostly: float = tuned(0.85, "1", 0, 1)  # a map that leaves more of the area in place leaves all of it in place


OVERLAP = OverlapTuning()


def overlapping(pair: Pair) -> Floats | None:
    """(n_t, 3) the target shape's vertices where they are in space, in the source part's frame, if the two overlap."""
    source, target = pair.source_shape, pair.target_shape
    here, there = standing(pair)[target.proxy.full_vertex], source.proxy.vertices
    near = OVERLAP.near * max(float(np.ptp(places, axis=0).max()) for places in (here, there))
    for shape, places, other, others in ((target, here, source, there), (source, there, target, here)):
        found = SurfaceMap(*closest_points(places, others, other.mesh.triangles, near), other.mesh.triangles)
        elsewhere = np.linalg.norm(found.interpolate(others) - places, axis=1) > near
        if shape.basis.areas[elsewhere].sum() > OVERLAP.max_elsewhere * shape.basis.areas.sum():
            return None
    return here


def leaves_in_place(images: Floats, places: Floats, areas: Floats) -> bool:
    """Whether a map from places (n, 3), of areas (n,), to images (n, 3) is the identity in space, up to its errors."""
    stays = np.linalg.norm(images - places, axis=1) < OVERLAP.stays
    return bool(areas[stays].sum() > OVERLAP.mostly * areas.sum())
