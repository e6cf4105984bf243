# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaps that a registered part leaves on the whole, although the part has no cut there.

A part of a surface covers all of the whole up to its own cuts. If a limb of the part is on another limb of the whole,
its true place is a gap, which begins where the part continues. The fit of the part does not show this.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.mesh.triangles import edge_graph, unique_edges

# Name of the area of the gaps that a finished part leaves on the whole, see `gap_area`.
GAPS = "gaps"


def gap_area(covered: Booleans, cut_distance: Floats, whole: IncompleteShape, near: float) -> float:
    """The area of the whole that is not covered, and nearest to a place where the part has no cut.

    Args:
        covered: (n,) whether a vertex of the whole has a partner on the part.
        cut_distance: (n,) distance from that partner to the part's nearest cut.
        whole: the shape that has these vertices.
        near: the part may end where a cut is nearer than this.
    """
    mesh = whole.shape.mesh
    edges, _ = unique_edges(mesh.triangles)
    ends = edges[covered[edges[:, 0]] != covered[edges[:, 1]]]
    if not len(ends):
        return 0.0
    border = np.unique(ends[covered[ends]])
    graph = edge_graph(mesh.vertices, mesh.triangles)
    _, _, nearest = dijkstra(graph, indices=border, min_only=True, return_predecessors=True)
    missed = ~covered & (nearest >= 0)
    missed[missed] = cut_distance[nearest[missed]] > near
    return float(whole.shape.basis.areas[missed].sum())
