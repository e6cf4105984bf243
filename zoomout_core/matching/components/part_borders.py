# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean borders between the parts of a source that a target receives from.

Each vertex maps to the nearest part. Where two parts are about equally near, as hair and scalp or the two sides of a
joint are, errors of a voxel decide: borders zigzag, and flecks of the one remain in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.label_borders import border_lengths, shorten_borders
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.matching.components.parts import Side
from zoomout_core.mesh.triangles import edge_lengths, unique_edges, vertex_areas
from zoomout_core.tuning import Tuning, tuned

# Distance from a border, at unit area, up to which labels may change, and the rings that this is at most.
BAND, MAX_RINGS = 0.01, 4
# Share of a part's area on the target that it may lose to shorter borders, otherwise none.
MAX_LOSS = 0.25


@dataclass(frozen=True)
class PartBorderTuning(Tuning, set_by="everywhere"):
    """How much nearer a part must be to keep a place behind a longer border."""

    # A fleck of this radius disappears if the part around it is farther away by at most twice this distance.
    straightening: float = tuned(0.001, "at unit area", 1e-6, 1)


PART_BORDERS = PartBorderTuning()


def straighten_borders(
    triangle: Integers,
    distance: Floats,
    points: Floats,
    normals: Floats,
    movable: Booleans,
    among: Integers,
    source: Side,
    target: Side,
    normal_weight: float,
) -> tuple[Integers, Integers, Floats, Floats]:
    """Map vertices beside the borders between parts to other parts, where that shortens the borders.

    Args:
        triangle: (n,) the triangle of the source that each vertex of the target maps to.
        distance: (n,) how far the vertex is from it, moved to the source.
        points: (n, 3) the vertices, moved to the source.
        normals: (n, 3) theirs there.
        movable: (n,) which vertices may map to another part.
        among: (m,) the triangles of the source that they may map to.
        source: the surface with the parts.
        target: the surface whose vertices are mapped.
        normal_weight: the distance that counts as much as a unit difference of normals.

    Returns:
        (q,) the vertices that change, and (q,), (q, 3) and (q,) their triangles, barycentric coordinates and distances.
    """
    component = source.mesh.component[source.mesh.triangles[:, 0]]
    part, mesh = component[triangle], target.mesh
    edges, _ = unique_edges(mesh.triangles)
    border = edges[part[edges[:, 0]] != part[edges[:, 1]]]
    none = np.zeros(0, dtype=np.int64)
    if not len(border):
        return none, none, np.zeros((0, 3)), np.zeros(0)
    graph = _adjacency(edges, len(part))
    width = max(float(edge_lengths(target.points, border).mean()), BAND / MAX_RINGS)
    beside = np.unique(border)
    labels = csr_array(
        (np.ones(len(beside), dtype=np.int32), (beside, part[beside])), shape=(len(part), part.max() + 1)
    )
    for _ in range(int(np.ceil(BAND / width))):
        labels = labels + graph @ labels
        labels.data[:] = 1
    labels.sort_indices()
    vertex, label = labels.nonzero()
    other = movable[vertex] & np.isin(label, component[among]) & (label != part[vertex])
    vertex, label = vertex[other], label[other].astype(np.int64)
    surface = OrientedSurface(
        source.points, source.mesh.triangles[among], source.mesh.flipped[among], normal_weight, component[among]
    )
    found, barycentric, apart = surface.closest(points[vertex], normals[vertex], label)
    # The vertices that may change, and those around them.
    band = np.unique(vertex)
    around = graph[band]
    own = np.unique(np.concatenate([band, around.indices, (around @ graph).indices]))
    number = np.full(len(part), -1)
    number[own] = np.arange(len(own))
    areas = vertex_areas(target.points, mesh.triangles)
    length = border_lengths(target.points[own], areas[own], graph[own][:, own])
    cost = np.maximum(apart - distance[vertex], 0) * areas[vertex] / PART_BORDERS.straightening**2
    # A vertex whose cost is larger than all the border around it goes back to its part in any case.
    worth = cost < np.asarray(length.sum(axis=1))[number[vertex]]
    vertex, label, cost, found, barycentric, apart = (
        each[worth] for each in (vertex, label, cost, found, barycentric, apart)
    )
    candidate = np.concatenate([number[vertex], np.arange(len(own))])
    order = np.argsort(candidate, kind="stable")
    labels_of, costs = np.concatenate([label, part[own]]), np.concatenate([cost, np.zeros(len(own))])
    chosen = order[shorten_borders(candidate[order], labels_of[order], costs[order], length)]
    moved = chosen[chosen < len(vertex)]
    # Thin parts, such as straps, do not give way to a shorter border.
    before = np.bincount(part, areas)
    loss = np.bincount(part[vertex[moved]], areas[vertex[moved]], minlength=len(before))
    moved = moved[(loss <= MAX_LOSS * before)[part[vertex[moved]]]]
    return vertex[moved], among[found[moved]], barycentric[moved], apart[moved]


def _adjacency(edges: Integers, n: int) -> csr_array:
    """(n, n) ones where an edge (e, 2) is."""
    ends = np.concatenate([edges, edges[:, ::-1]])
    return csr_array((np.ones(len(ends), dtype=np.int32), ends.T), shape=(n, n))
