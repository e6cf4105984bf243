# SPDX-License-Identifier: GPL-3.0-or-later
"""Ways to transfer the keys of one head to another: (keys, n_t, 3) offsets, in the space of the target."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import trimesh
from scipy.interpolate import RBFInterpolator
from trimesh.registration import nricp_amberg

import zoomout_core as zo
from benchmarks.faces.cases import Case
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.matching.result import MatchResult

Method = Callable[[Case, MatchResult], Floats | None]
NEIGHBOURS = 50  # landmarks that determine the thin-plate spline around a point


def by_transfer(case: Case, match: MatchResult) -> Floats:
    """The product: `zo.transfer` along the match."""
    keys = zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, case.columns, tuple(case.names))
    return np.moveaxis(np.asarray(zo.transfer(keys, match).values), 1, 0)


def along_map(case: Case, match: MatchResult) -> Floats:
    """Offsets interpolated along the match, turned and scaled like the whole head."""
    images = match.surface_map.interpolate(case.source.vertices)
    return _place(match.surface_map, case, procrustes(images, case.target.vertices))


def nearest_surface(case: Case, _: MatchResult) -> Floats:
    """The source's nearest point, after the best similarity: of the true landmarks, or of the bounding boxes."""
    aligned = _align(case)
    return _place(_nearest(case, aligned(case.source.vertices)), case, aligned)


def thin_plate_spline(case: Case, _: MatchResult) -> Floats | None:
    """The source's nearest point, after a thin-plate spline through the 68 true landmarks."""
    if case.landmarks is None:
        return None
    marks, places = case.landmarks
    spline = RBFInterpolator(case.source.vertices[marks], places, NEIGHBOURS, kernel="thin_plate_spline", degree=1)
    return _place(_nearest(case, spline(case.source.vertices)), case, _align(case))


def nonrigid_icp(case: Case, _: MatchResult) -> Floats | None:
    """The source's nearest point, after non-rigid ICP from the true landmarks (Amberg 2007, by trimesh)."""
    if case.landmarks is None:
        return None
    marks, places = case.landmarks
    aligned = _align(case)
    moving, fixed = (
        trimesh.Trimesh(vertices, surface.triangles, process=False)
        for vertices, surface in ((aligned(case.source.vertices), case.source), (case.target.vertices, case.target))
    )
    registered = nricp_amberg(moving, fixed, source_landmarks=marks, target_positions=places, neighbors_count=8)
    return _place(_nearest(case, np.asarray(registered)), case, aligned)


METHODS: dict[str, Method] = {
    "transfer": by_transfer,
    "along the map": along_map,
    "nearest surface": nearest_surface,
    "spline of 68 true landmarks": thin_plate_spline,
}
SLOW_METHODS: dict[str, Method] = {"non-rigid ICP from 68 true landmarks": nonrigid_icp}


def _align(case: Case) -> Similarities:
    """The similarity that brings the source closest to the target."""
    if case.landmarks is None:
        return procrustes(_box_corners(case.source.vertices), _box_corners(case.target.vertices))
    marks, places = case.landmarks
    return procrustes(case.source.vertices[marks], places)


def _box_corners(vertices: Floats) -> Floats:
    """(8, 3) the corners of the bounding box."""
    return np.array(list(product(*zip(vertices.min(axis=0), vertices.max(axis=0), strict=True))))


def _nearest(case: Case, moved: Floats) -> zo.SurfaceMap:
    """The map to the closest points of the source with moved vertices (n_s, 3)."""
    return zo.SurfaceMap(*closest_points(case.target.vertices, moved, case.source.triangles), case.source.triangles)


def _place(surface_map: zo.SurfaceMap, case: Case, aligned: Similarities) -> Floats:
    """The keys interpolated along a map, with the linear part of a similarity applied."""
    return np.moveaxis(surface_map.interpolate(case.columns), 1, 0) @ aligned.linear.T
