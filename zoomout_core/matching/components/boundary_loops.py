# SPDX-License-Identifier: GPL-3.0-or-later
"""Clothes of one cut have boundary loops (hems) in common, which correct the body's map of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.matching.components.parts import Part
from zoomout_core.mesh.triangles import border_edges
from zoomout_core.spectral.laplacian import mesh_laplacian

# Two loops belong to the same cut if their centres are at most this far apart, at unit area,
MAX_LOOP_DISTANCE = 0.15
# and their sizes differ by at most this factor.
MAX_LOOP_SIZE_RATIO = 1.5
# Segments into which each edge of a loop is sampled.
SEGMENTS_PER_EDGE = 4
# Penalty weight that pulls a loop's vertices to their goals (1 / area): large, so that stiffness hardly moves them off.
LOOP_WEIGHT = 1e6
# Length over which a loop's displacement decays into the part, at unit area.
DECAY_LENGTH = 0.5


@dataclass(frozen=True, eq=False)
class BoundaryLoop:
    """A connected part of a border."""

    vertices: Integers  # (n,) by their places in the part's vertices
    along: Floats  # (p, 3) points that cover it evenly edge by edge, the ends of each among them
    centre: Floats  # (3,) of its length
    size: float  # root mean square distance from the centre


def loops_on_loops(part: Part, partner: Part) -> Floats:
    """(n, 3) a part's points, moved so that its boundary loops coincide with those of its partner; the rest follows."""
    ours, theirs = boundary_loops(part), boundary_loops(partner)
    if not ours or not theirs:
        return part.points
    stiffness, areas = mesh_laplacian(part.rest, part.corners)
    apart = np.linalg.norm(np.array([loop.centre for loop in ours])[:, None] - [loop.centre for loop in theirs], axis=2)
    goals, weight = np.zeros_like(part.points), areas / DECAY_LENGTH**2
    for i, loop in enumerate(ours):
        j = int(np.argmin(apart[i]))
        other = theirs[j]
        alike = max(loop.size, other.size) <= MAX_LOOP_SIZE_RATIO * min(loop.size, other.size)
        if alike and apart[i, j] <= MAX_LOOP_DISTANCE and np.argmin(apart[:, j]) == i:
            points = part.points[loop.vertices]
            near = cKDTree(other.along).query(points - loop.centre + other.centre)[1]
            goals[loop.vertices], weight[loop.vertices] = other.along[near] - points, LOOP_WEIGHT
    return np.asarray(part.points + ScreenedSmoothing.of(weight, stiffness, 1).smooth(goals))


def boundary_loops(part: Part) -> list[BoundaryLoop]:
    """The connected parts of a part's border."""
    border = border_edges(part.corners)
    n = len(part.vertices)
    graph = coo_array((np.ones(len(border), bool), border.T), shape=(n, n))
    label = connected_components(graph, directed=False)[1][border[:, 0]]
    return [_boundary_loop(border[label == number], part.points) for number in np.unique(label)]


def _boundary_loop(edges: Integers, points: Floats) -> BoundaryLoop:
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    length = np.linalg.norm(b - a, axis=1)
    weights = length / max(length.sum(), 1e-300)
    centre = weights @ (a + b) / 2
    size = float(np.sqrt(weights @ (((a + b) / 2 - centre) ** 2).sum(axis=1)))
    step = np.linspace(0, 1, SEGMENTS_PER_EDGE + 1)[:, None, None]
    return BoundaryLoop(np.unique(edges), ((1 - step) * a + step * b).reshape(-1, 3), centre, size)
