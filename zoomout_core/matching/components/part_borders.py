# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean borders between the parts of a source that a target receives from.

Each vertex maps to the nearest part, moved by its rigid pieces. Where two parts are about equally near, such as hair
and scalp or the two sides of a joint, errors of a voxel decide between them: borders zigzag, and flecks of one part
remain in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.label_borders import border_lengths, shorten_borders
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.matching.components.part_motions import PartMotions
from zoomout_core.matching.components.parts import Side
from zoomout_core.mesh.triangles import edge_lengths, unique_edges, vertex_areas
from zoomout_core.tuning import Tuning, tuned

# Maximum distance from a border, at unit area and in rings, at which labels may change.
BAND, MAX_RINGS = 0.03, 6
# The border around a vertex is shorter than this multiple of the root of its area: dearer candidates are not tried.
MAX_BORDER = 4.0


@dataclass(frozen=True)
class PartBorderTuning(Tuning, set_by="everywhere"):
    """How much nearer a part must be to take a place."""

    # A fleck of this radius disappears if the part around it is farther away by at most twice this distance.
    straightening: float = tuned(0.001, "at unit area", 1e-6, 1)
    # Distance by which a part without its own motion must be nearer to a vertex than the rigid piece there. The body's
    # map moves such a part there in any case, whereas the place of the rigid piece is exact.
    body_error: float = tuned(0.01, "at unit area", 0, 1)


PART_BORDERS = PartBorderTuning()


def straighten_borders(
    triangle: Integers,
    distance: Floats,
    movable: Booleans,
    motions: PartMotions,
    surface: OrientedSurface,
    source: Side,
) -> tuple[Integers, Integers, Floats, Floats]:
    """Map vertices to the parts that are nearest by their own motions, with short borders between parts.

    Args:
        triangle: (n,) the triangle of the source that each vertex of the target maps to.
        distance: (n,) distance of the vertex from it, after it is moved to the source by the body's map.
        movable: (n,) which vertices may map to another place.
        motions: of the parts.
        surface: the triangles of the source that they may map to, grouped by part.
        source: the surface with the parts.

    Returns:
        (q,) the vertices that change, and (q,), (q, 3) and (q,) their triangles among those of `surface`, barycentric
        coordinates and distances.
    """
    target = motions.target
    part = source.mesh.component[source.mesh.triangles[triangle, 0]]
    edges, _ = unique_edges(target.mesh.triangles)
    graph = adjacency(edges, len(part))
    vertex, label = _candidates(part, edges, graph, target)
    contested = np.bincount(vertex)[vertex] > 1
    areas = np.maximum(vertex_areas(target.points, target.mesh.triangles), 1e-300)
    max_detour = MAX_BORDER * PART_BORDERS.straightening**2 / np.sqrt(areas)
    apart = np.where(label == part[vertex], distance[vertex], np.inf)
    may_move = contested & movable[vertex] & surface.has_group(label)

    def measure(some: Integers, limit: Floats) -> None:
        """Compute the distances of some candidates, but for those beyond the limit (n,) of their vertices."""
        places, turned = motions.transform(vertex[some], label[some])
        near = surface.min_distance(places, label[some]) <= limit[vertex[some]]
        some, places, turned = some[near], places[near], turned[near]
        apart[some] = surface.closest(places, turned, label[some])[2]

    # The distance from the vertex's own part is known, unless a piece of it moves by itself.
    own = np.flatnonzero(label == part[vertex])
    rigid = np.zeros(len(vertex), dtype=bool)
    rigid[may_move] = motions.pieces(vertex[may_move], label[may_move]) >= 0
    measure(own[rigid[own]], np.full(len(part), np.inf))
    measure(np.flatnonzero(may_move & (label != part[vertex])), apart[own] + max_detour)
    compared = apart + PART_BORDERS.body_error * (rigid[own][vertex] & ~rigid)
    detour = compared - np.minimum.reduceat(compared, np.flatnonzero(np.diff(vertex, prepend=-1)))[vertex]
    worth = np.flatnonzero(detour <= max_detour[vertex])
    cost = detour[worth] * areas[vertex[worth]] / PART_BORDERS.straightening**2
    chosen = worth[_shorten(vertex[worth], label[worth], cost, graph, target, areas)]
    chosen = chosen[label[chosen] != part[vertex[chosen]]]
    changed = vertex[chosen]
    # Images by the body's map: rigid parts side by side would tear the map apart.
    return changed, *surface.closest(motions.points[changed], motions.normals[changed], label[chosen])


def _candidates(part: Integers, edges: Integers, graph: csr_array, target: Side) -> tuple[Integers, Integers]:
    """The vertices (k,), ascending, and the parts (k,) that they may map to: their own, and those nearby."""
    labels = csr_array((np.ones(len(part), dtype=np.int32), (np.arange(len(part)), part)))
    border = edges[part[edges[:, 0]] != part[edges[:, 1]]]
    if len(border):
        width = max(float(edge_lengths(target.points, border).mean()), BAND / MAX_RINGS)
        for _ in range(int(np.ceil(BAND / width))):
            labels = labels + graph @ labels
            labels.data[:] = 1
    labels.sort_indices()
    vertex, label = labels.nonzero()
    return vertex.astype(np.int64), label.astype(np.int64)


def _shorten(
    vertex: Integers, label: Integers, cost: Floats, graph: csr_array, target: Side, areas: Floats
) -> Integers:
    """(n,) the chosen candidate of each vertex, see `shorten_borders`; the only one of those that no part contests."""
    first = np.flatnonzero(np.diff(vertex, prepend=-1))
    contested = np.diff(first, append=len(vertex)) > 1
    around = graph[contested]
    near = np.unique(np.concatenate([np.flatnonzero(contested), around.indices, (around @ graph).indices]))
    if not len(near):
        return first
    number = np.full(len(contested), -1)
    number[near] = np.arange(len(near))
    length = border_lengths(target.points[near], areas[near], graph[near][:, near])
    among = np.flatnonzero(number[vertex] >= 0)
    first[near] = among[shorten_borders(number[vertex[among]], label[among], cost[among], length)]
    return first


def adjacency(edges: Integers, n: int) -> csr_array:
    """(n, n) ones where an edge (e, 2) is."""
    ends = np.concatenate([edges, edges[:, ::-1]])
    return csr_array((np.ones(len(ends), dtype=np.int32), ends.T), shape=(n, n))
