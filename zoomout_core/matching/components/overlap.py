"""Two surfaces that lie over each other already, as the characters of one pack do, which share a pose."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair, standing

# Places are over each other that are nearer than this part of the longest extent; surfaces are if no more than so large
# a part of either lies elsewhere: on pairs in one pose it was 0.05 at most, and 0.18 at least on all others.
OVER, MOST_ELSEWHERE = 0.05, 0.06
# A map leaves a place where it stands that it moves by no more than this, at unit area; one that does so with so large
# a part of them has them all stay.
STAYS, MOSTLY = 0.1, 0.85


def overlapping(pair: Pair) -> Floats | None:
    """(n_t, 3) the vertices of the target shape's mesh as the surfaces stand, in the frame of the source's part.

    None unless the two lie over each other.
    """
    source, target = pair.source_shape, pair.target_shape
    here, there = standing(pair)[target.proxy.full_vertex], source.proxy.vertices
    near = OVER * max(float(np.ptp(places, axis=0).max()) for places in (here, there))
    for shape, places, other, others in ((target, here, source, there), (source, there, target, here)):
        found = SurfaceMap(*closest_points(places, others, other.mesh.triangles, near), other.mesh.triangles)
        elsewhere = np.linalg.norm(found.interpolate(others) - places, axis=1) > near
        if shape.basis.areas[elsewhere].sum() > MOST_ELSEWHERE * shape.basis.areas.sum():
            return None
    return here


def leaves_in_place(images: Floats, places: Floats, areas: Floats) -> bool:
    """Whether a map that takes places (n, 3) to images (n, 3) means what lies over them, but for its errors.

    Args:
        images: at unit area.
        places: at unit area.
        areas: (n,) that they stand for.
    """
    stays = np.linalg.norm(images - places, axis=1) < STAYS
    return bool(areas[stays].sum() > MOSTLY * areas.sum())
