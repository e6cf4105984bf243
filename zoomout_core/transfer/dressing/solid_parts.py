# SPDX-License-Identifier: GPL-3.0-or-later
"""Solid parts, such as eyes, teeth and buttons, which rotate and scale as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers, segment_sum
from zoomout_core.geometry.procrustes import SMALLEST, procrustes
from zoomout_core.mesh.triangles import area_normals
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.transfer.groups import group_starts, label_groups
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class SolidTuning(Tuning, set_by="outfits"):
    """Which parts are solid, and how they move.

    Attributes:
        small: maximum extent of a solid part.
        touching: parts closer to each other than this move as one.
        compact: minimum squared volume of a solid part, relative to a ball of the same area.
        share: share of the area of touching parts that must be solid.
        beside: a part follows a larger one that is closer than this share of its extent.
        neighbours: number of points of the larger part near each point that determine the motion.
    """

    small: float = tuned(0.08, "at unit area", 0, 10)
    touching: float = tuned(0.004, "at unit area", 0, 1)
    compact: float = tuned(0.2, "1", 0, 1)
    share: float = tuned(0.3, "1", 0, 1)
    beside: float = tuned(0.3, "1", 0, 10)
    neighbours: int = tuned(8, "points", 1, 1000)


SOLID = SolidTuning()
# Number of points of other parts to test for touching.
NEAREST = 8


def solid_parts(form: Form) -> list[Integers]:
    """Points of each group of small touching parts that are solid together."""
    extent = _extents(form.rest, form.component)
    small = extent < SOLID.small
    if not len(form.triangles) or not small.any():
        return []
    points = np.flatnonzero(small[form.component])
    group = _touching(form.rest[points], form.component[points], len(extent))
    corner = form.triangles[:, 0]
    normals = area_normals(form.rest, form.triangles)
    area = segment_sum(np.linalg.norm(normals, axis=1) / 2, form.component[corner], len(extent))
    middle = segment_sum(form.rest, form.component, len(extent)) / np.bincount(form.component)[:, None]
    height = form.rest[form.triangles].mean(axis=1) - middle[form.component[corner]]
    volume = segment_sum(np.einsum("mx,mx->m", height, normals) / 6, form.component[corner], len(extent))
    compact = 36 * np.pi * volume**2 > SOLID.compact * np.maximum(area, SMALLEST) ** 3
    parts = []
    for number in np.unique(group[small]):
        of_group = small & (group == number)
        inside = points[of_group[form.component[points]]]
        together = float(np.ptp(form.rest[inside], axis=0).max())
        if together < SOLID.small and area[of_group & compact].sum() >= SOLID.share * area[of_group].sum():
            parts.append(inside)
    return parts


def with_solid_parts(form: Form, parts: list[Integers], soft: Integers, images: Floats, positions: Floats) -> Floats:
    """(n, 3) positions of a form with solid parts moved by similarities.

    A part follows the soft points beside it, at positions (n, 3) of the soft fit. Without any, it follows the body,
    which moves its points to images (n, 3).
    """
    if not parts:
        return positions
    found, tree = positions.copy(), cKDTree(form.rest[soft]) if len(soft) else None
    for part in parts:
        extent = float(np.ptp(form.rest[part], axis=0).max())
        if tree is not None and np.min(tree.query(form.rest[part])[0]) < SOLID.beside * extent:
            near = soft[np.unique(tree.query(form.rest[part], min(SOLID.neighbours, len(soft)))[1])]
            motion = procrustes(form.rest[near], positions[near])
        else:
            motion = procrustes(form.rest[part], images[part], form.areas[part])
        found[part] = motion(form.rest[part])
    return found


def _extents(points: Floats, component: Integers) -> Floats:
    """(c,) longest side of the bounding box of each component."""
    order = np.argsort(component, kind="stable")
    first = group_starts(component[order])
    sides = np.maximum.reduceat(points[order], first) - np.minimum.reduceat(points[order], first)
    return np.asarray(sides.max(axis=1))


def _touching(points: Floats, component: Integers, count: int) -> Integers:
    """(c,) numbers of groups of touching components."""
    pairs = component[touching_points(points, component)]
    return label_groups(count, pairs[:, 0], pairs[:, 1])


def touching_points(points: Floats, component: Integers) -> Integers:
    """(p, 2) pairs of touching points (n, 3) of different components (n,); for each point only some of its nearest."""
    nearest = min(NEAREST, len(points))
    distance, near = (np.asarray(each).ravel() for each in cKDTree(points).query(points, nearest))
    first = np.repeat(np.arange(len(points)), nearest)
    return np.column_stack([first, near])[(distance < SOLID.touching) & (component[first] != component[near])]
