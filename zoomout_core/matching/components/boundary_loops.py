"""Clothes of one cut have boundary loops (hems) in common, which correct the body's map of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.sparse_solve import factorised
from zoomout_core.matching.components.parts import Part
from zoomout_core.mesh.triangles import border_edges
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class BoundaryLoopTuning(Tuning, set_by="judgement"):
    """Which boundary loops belong together, and how the rest of a part follows them.

    Attributes:
        most_apart: of the centres of two loops of one cut.
        most_unlike: factor by which their sizes may differ.
        points_per_edge: that stand for a loop, and one more.
        loop_weight: of the loops' goals against stiffness.
        screening_length: over which displacements of loops fade, at unit area of the part.
    """

    most_apart: float = tuned(0.15, "at unit area", 0, 10)
    most_unlike: float = tuned(1.5, "1", 1, 100)
    points_per_edge: int = tuned(4, "points", 1, 1000)
    loop_weight: float = tuned(1e6, "1 / area", 1, 1e12)
    screening_length: float = tuned(0.5, "at unit area", 1e-3, 100)


LOOPS = BoundaryLoopTuning()


@dataclass(frozen=True, eq=False)
class BoundaryLoop:
    """A connected part of a border.

    Attributes:
        vertices: (n,) by their places in the part's vertices.
        along: (p, 3) points that cover it evenly edge by edge, the ends of each among them.
        centre: (3,) of its length.
        size: root mean square distance from the centre.
    """

    vertices: Integers
    along: Floats
    centre: Floats
    size: float


def loops_on_loops(part: Part, partner: Part) -> Floats:
    """(n, 3) a part's points, moved so that its boundary loops lie on those of its partner; the rest follows."""
    ours, theirs = boundary_loops(part), boundary_loops(partner)
    if not ours or not theirs:
        return part.points
    stiffness, areas = mesh_laplacian(part.rest, part.corners)
    apart = np.linalg.norm(np.array([loop.centre for loop in ours])[:, None] - [loop.centre for loop in theirs], axis=2)
    goals, weight = np.zeros_like(part.points), areas / LOOPS.screening_length**2
    for i, loop in enumerate(ours):
        j = int(np.argmin(apart[i]))
        other = theirs[j]
        alike = max(loop.size, other.size) <= LOOPS.most_unlike * min(loop.size, other.size)
        if alike and apart[i, j] <= LOOPS.most_apart and np.argmin(apart[:, j]) == i:
            points = part.points[loop.vertices]
            near = cKDTree(other.along).query(points - loop.centre + other.centre)[1]
            goals[loop.vertices], weight[loop.vertices] = other.along[near] - points, LOOPS.loop_weight
    factors = factorised(stiffness + diags_array(weight))
    return np.asarray(part.points + factors.solve(weight[:, None] * goals))


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
    step = np.linspace(0, 1, LOOPS.points_per_edge + 1)[:, None, None]
    return BoundaryLoop(np.unique(edges), ((1 - step) * a + step * b).reshape(-1, 3), centre, size)
