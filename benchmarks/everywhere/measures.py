# SPDX-License-Identifier: GPL-3.0-or-later
"""Local errors of a map: parts, limbs and torn edges."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csr_array

import zoomout_core as zo
from benchmarks.datasets import FEW_PLACES
from benchmarks.everywhere.cases import Case
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.evaluation import geodesic_error
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.mesh.triangles import unique_edges, vertex_areas
from zoomout_core.transfer.rigging.poses import extreme_poses
from zoomout_core.transfer.rigging.stretch import check_weights, play, stretched_edges
from zoomout_core.transfer.rigging.weight_islands import find_islands

Row: TypeAlias = dict[str, Any]

# An edge is torn if its image is longer than this multiple of the median ratio, and than this fraction of the height.
TORN_RATIO, TORN_LENGTH = 5.0, 0.02
# A map is wrong in the small if less arrives from the right part, more on another limb, or more edges are torn; and as
# a whole if it is further off on average, at unit area. Right maps of animals of other species are .02 to .06 off.
RIGHT_PART, WRONG_LIMB, TORN, WRONG_PLACE = 0.97, 0.01, 0.01, 0.1
# A part counts as visible if it is this share of the target's area, and as lost if less of that receives from it.
VISIBLE, LOST = 0.001, 0.5


def measure(case: Case, surface_map: zo.SurfaceMap) -> Row:
    """The figures of a map; None if the truth of the case does not include them.

    `part`: share of the target's area that receives from the right part; `lost`: how many of `visible` parts are;
    `limb`: share of limb vertices that are mapped to another limb; `torn`: share of edges;
    `off`: mean geodesic error at unit area.
    """
    arrived = case.source_part[surface_map.vertex]
    known = case.target_part >= 0
    areas = vertex_areas(case.target.vertices, case.target.triangles)
    lost, visible = count_lost(case.target_part, arrived, areas)
    on_limb = (case.target_limb != 0) & np.isin(case.target_limb, case.source_limb)
    return {
        "part": float(areas[known & (arrived == case.target_part)].sum() / areas[known].sum()) if known.any() else None,
        "lost": lost if known.any() else None,
        "visible": visible if known.any() else None,
        "limb": float(np.mean(wrong_limb(case, surface_map)[on_limb])) if on_limb.any() else None,
        "torn": float(torn_edges(case, surface_map).mean()),
        "off": None if case.image is None else _mean_error(case, case.image, surface_map),
    }


def measure_binding(case: Case, surface_map: zo.SurfaceMap) -> Row:
    """The figures of a target that is bound to the source's rig along a map; None if there is no rig.

    `stretched`: share of edges that grow over twice as much as the source does when bones turn to extremes, after the
    check of *Bind to Rig*; `unchecked`: before it; `islands`: share of the vertices on islands of a bone.
    """
    if case.rig is None:
        return {"stretched": None, "unchecked": None, "islands": None}
    rest, weights, heads, parents = case.rig
    source = case.source.with_vertices(rest)
    labels = tuple(map(str, range(weights.shape[1])))
    attribute = zo.Attribute("skin", zo.Domain.POINT, zo.Kind.WEIGHT, weights, labels)
    carried = zo.transfer(attribute, surface_map, case.source, case.target)
    placed = procrustes(case.target.vertices, surface_map.interpolate(rest))(case.target.vertices)
    target = case.target.with_vertices(placed)
    poses = extreme_poses(heads, parents)
    played, size = play(source, weights, poses), float(np.ptp(placed, axis=0).max())

    def stretch_share(tried: csr_array) -> float:
        return float(stretched_edges(played, play(target, tried, poses), surface_map, size).mean())

    checked = check_weights(source, weights, target, carried.values, surface_map, poses).weights
    islands = find_islands(surface_map, source, weights, target, checked)
    return {
        "stretched": stretch_share(checked),
        "unchecked": stretch_share(carried.values),
        "islands": (islands >= 0).mean(),
    }


def is_wrong(figures: Row) -> bool:
    """Whether a map is unusable by its figures: a visible part is lost, limbs are exchanged, or edges are torn."""
    part, limb, off = figures["part"], figures["limb"], figures["off"]
    lost = part is not None and (part < RIGHT_PART or figures["lost"] > 0)
    elsewhere = (limb is not None and limb > WRONG_LIMB) or (off is not None and off > WRONG_PLACE)
    return lost or elsewhere or figures["torn"] > TORN


def _mean_error(case: Case, image: Integers, surface_map: zo.SurfaceMap) -> float:
    """The mean geodesic error of a map at some of the target's vertices with known images (n_t,)."""
    known = np.flatnonzero(image >= 0)
    errors = geodesic_error(surface_map.vertex, case.source, known, image[known], FEW_PLACES)
    return float(errors[np.isfinite(errors)].mean())


def wrong_limb(case: Case, surface_map: zo.SurfaceMap) -> Booleans:
    """(n_t,) which target vertices on a limb are mapped to another limb."""
    limb = case.source_limb[surface_map.vertex]
    return (case.target_limb != 0) & (limb != 0) & (limb != case.target_limb)


def torn_edges(case: Case, surface_map: zo.SurfaceMap) -> Booleans:
    """(e,) which edges of the target, as `unique_edges` orders them, have images that are far too long."""
    edges, _ = unique_edges(case.target.triangles)
    images = surface_map.interpolate(case.source.vertices)
    own, image = (np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (case.target.vertices, images))
    ratio = image / np.maximum(own, 1e-300)
    height = np.ptp(case.source.vertices, axis=0).max()
    return np.asarray((ratio > TORN_RATIO * np.median(ratio)) & (image > TORN_LENGTH * height))


def count_lost(right: Integers, arrived: Integers, areas: Floats) -> tuple[int, int]:
    """How many visible parts are mostly lost, and how many are visible."""
    lost = visible = 0
    for part in np.unique(right[right >= 0]).tolist():
        here = right == part
        if areas[here].sum() >= VISIBLE * areas.sum():
            visible += 1
            lost += bool(areas[here & (arrived == part)].sum() < LOST * areas[here].sum())
    return lost, visible
