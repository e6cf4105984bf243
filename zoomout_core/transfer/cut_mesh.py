# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut a surface open along the edges where corner data jumps: at UV seams or hard edges of colours.

Corners around a vertex form one cut vertex as long as data is continuous from face to face. So the sides of a seam have
no common vertex, even where a chart borders itself. Points are located by descending the distance from triangle to
triangle, starting on the right side; no walk crosses a cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.closest_points import barycentric_of_closest, consecutive
from zoomout_core.geometry.embedded_surface import HUB
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each, threads
from zoomout_core.transfer.groups import expand_ranges, group_starts, label_groups

# Corner values closer than this share of their range are equal: a tenth of a texel of an 8k texture.
CUT_TOLERANCE = 2.0**-16
# Points closer to a triangle than this share of the surface's size are on it.
ON_SURFACE = 1e-9
# A closest point with a smaller barycentric coordinate is on the rim of its triangle.
RIM = 1e-9
# Maximum number of faces at one edge that are compared; only broken meshes have more.
MAX_FACES_AT_EDGE = 8
# Points processed together, so that the arrays fit into a processor's cache, and pairs of a point and a triangle.
BLOCK, PAIRS = 1 << 14, 1 << 18
# Cosine of the angle between the normals of a triangle and of its vertex below which walks also search around a closest
# point. A steep or folded triangle hides others from the points above it.
MIN_NORMAL_COSINE = 0.5


@dataclass(frozen=True, eq=False)
class CutSurface:
    """A surface and the connections of its corners."""

    surface: Surface  # the surface that is cut
    cut_vertex: Integers  # (c,) number of the cut vertex that each corner belongs to
    island: Integers  # (f,) number of the island, joined by edges without a cut, that each face belongs to
    border: Integers  # (b, 2) the corners at both ends of each face edge without a joined face

    @cached_property
    def triangle_island(self) -> Integers:
        """(m,) the island of each triangle."""
        return self.island[self.surface.triangle_face]

    @cached_property
    def _vertices(self) -> Integers:
        """(m, 3) the cut vertices of the triangles."""
        return self.cut_vertex[self.surface.triangle_corners]

    @cached_property
    def _fan(self) -> tuple[Integers, Integers]:
        """Triangles around the cut vertices: (v + 1,) where those of each vertex begin, and the triangles."""
        vertex = self._vertices.ravel()
        start = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=self.cut_vertex.max() + 1))])
        return start, np.argsort(vertex, kind="stable") // 3

    @cached_property
    def _degree(self) -> Integers:
        """(v,) number of triangles around each cut vertex."""
        return np.diff(self._fan[0])

    @cached_property
    def _folded(self) -> Booleans:
        """(m,) whether triangles around one are steep or folded, like slivers, seen along the corners' normals."""
        vertex = self._vertices.ravel()
        normal = np.repeat(triangle_normals(self.surface.vertices, self.surface.triangles), 3, axis=0)
        sums = segment_sum(normal, vertex)
        lying = np.einsum("qx,qx->q", normal, sums[vertex]) >= MIN_NORMAL_COSINE * np.linalg.norm(sums, axis=1)[vertex]
        folded = np.zeros(len(sums), dtype=bool)
        folded[vertex[~lying]] = True
        return np.asarray(folded[self._vertices].any(axis=1))

    @cached_property
    def _geometry(self) -> Floats:
        """(12, m) for each triangle a corner, the two sides from it (three rows each), and their inner products."""
        a, b, c = self.surface.vertices[self.surface.triangles].transpose(1, 2, 0)
        ab, ac = b - a, c - a
        return np.concatenate([a, ab, ac, [_dot(ab, ab), _dot(ab, ac), _dot(ac, ac)]])

    @cached_property
    def _size(self) -> float:
        return float(np.ptp(self.surface.vertices[self.surface.corner_vertex], axis=0).max())

    def walk(self, start: Integers, points: Floats) -> tuple[Integers, Floats, Floats]:
        """Find closest points by descending the distance from a start triangle, without crossing a cut.

        Args:
            start: (q,) the triangle that each walk begins at.
            points: (q, 3) the points to approach.

        Returns:
            (q,) triangles, (q, 3) barycentric coordinates in them, and (q,) the remaining distances, zero for points
            that were reached.
        """
        triangle = np.array(start)
        weights = np.empty((len(points), 3))
        distance = np.empty(len(points))
        columns = np.ascontiguousarray(points.T)

        def walk_on(first: int) -> None:
            block = slice(first, first + BLOCK)
            triangle[block], weights[block], distance[block] = self._walk(triangle[block], columns[:, block])

        with portion(0.0, 0.0):  # one of many lookups, which does not advance the progress
            for_each(walk_on, range(0, len(points), BLOCK))
        return triangle, weights, np.where(distance > self._size * ON_SURFACE, distance, 0)

    def _walk(self, start: Integers, points: Floats) -> tuple[Integers, Floats, Floats]:
        """`walk`, for points (3, q)."""
        triangle = start.copy()
        weights, distance = self._closest(triangle, points)
        walking = np.arange(len(triangle))

        def step(walking: Integers, leads_on: Booleans) -> Integers:
            query, candidate = self._around(triangle[walking], leads_on)
            found, gap = self._closest(candidate, points[:, walking[query]])
            lowest = np.minimum.reduceat(gap, group_starts(query))
            better = lowest < distance[walking] * (1 - ON_SURFACE)
            hit = np.flatnonzero((gap <= lowest[query]) & better[query])
            hit = hit[group_starts(query[hit])]
            walking = walking[better]
            triangle[walking], weights[walking], distance[walking] = candidate[hit], found[hit], gap[hit]
            return walking

        while len(walking := walking[self._may_improve(triangle, weights, distance, walking)]):
            leads_on = weights[walking] > RIM
            sizes = self._degree[self._vertices[triangle[walking]]]
            # The many triangles of a hub are searched only from the hub itself.
            leads_on &= (sizes <= HUB) | ~(leads_on & (sizes <= HUB)).any(axis=1, keepdims=True)
            blocks = consecutive((sizes * leads_on).sum(axis=1), PAIRS)
            walking = np.concatenate([step(walking[block], leads_on[block]) for block in blocks])
        return triangle, weights, distance

    def _may_improve(self, triangle: Integers, weights: Floats, distance: Floats, walking: Integers) -> Booleans:
        """Whether a walk has not reached its point, and another triangle may be closer."""
        on_rim = (weights <= RIM)[walking]
        leads_on = on_rim[:, 0] | on_rim[:, 1] | on_rim[:, 2] | self._folded[triangle[walking]]
        return leads_on & (distance[walking] > self._size * ON_SURFACE)

    def _closest(self, triangle: Integers, points: Floats) -> tuple[Floats, Floats]:
        """(q, 3) barycentric coordinates of the points of triangles closest to points (3, q), and the distances."""
        geometry = np.take(self._geometry, triangle, axis=1)
        ab, ac = geometry[3:6], geometry[6:9]
        offset = points - geometry[:3]
        weights = barycentric_of_closest((_dot(offset, ab), _dot(offset, ac), *geometry[9:]))
        offset -= weights[:, 1] * ab
        offset -= weights[:, 2] * ac
        return weights, np.sqrt(_dot(offset, offset))

    def _around(self, triangle: Integers, leads_on: Booleans) -> tuple[Integers, Integers]:
        """The triangles around some corners (q, 3) of triangles (q,), with the query of each."""
        start, fan = self._fan
        query, corner = np.divmod(np.flatnonzero(leads_on), 3)
        vertex = self._vertices[triangle[query], corner]
        owner, place = expand_ranges(start[vertex], start[vertex + 1])
        return query[owner], fan[place]


def _dot(first: Floats, second: Floats) -> Floats:
    """(q,) inner products of vectors (3, q)."""
    return np.asarray(first[0] * second[0] + first[1] * second[1] + first[2] * second[2])


def adjacent_edges(surface: Surface) -> tuple[Integers, Integers]:
    """Find common edges of faces: (e, 2) corners of one face and (e, 2) of the other at both ends of each edge.

    Each pair of faces at an edge occurs once. Borders that coincide in space are one edge, even if the mesh's vertices
    are split.
    """
    welded = surface.working.vertex_of[surface.corner_vertex]
    welded = np.where(welded >= 0, welded, len(surface.vertices) + surface.corner_vertex)
    edges = face_edges(surface)
    ends = welded[edges]
    edges = np.where((ends[:, 0] <= ends[:, 1])[:, None], edges, edges[:, ::-1])
    low, high = welded[edges].T
    key = low * (welded.max() + 1) + high
    order = np.argsort(key, kind="stable")
    order = order[low[order] != high[order]]
    key = key[order]
    first = [np.flatnonzero(key[step:] == key[:-step]) for step in range(1, MAX_FACES_AT_EDGE)]
    second = [same + step for step, same in enumerate(first, start=1)]
    return edges[order[np.concatenate(first)]], edges[order[np.concatenate(second)]]


def face_edges(surface: Surface) -> Integers:
    """(c, 2) edges of all faces, by their first and last corners."""
    following = np.arange(1, len(surface.corner_vertex) + 1)
    following[surface.face_start[1:] - 1] = surface.face_start[:-1]
    return np.stack([np.arange(len(following)), following], axis=1)


def corners_of_faces(surface: Surface, faces: Integers) -> tuple[Integers, Integers]:
    """The corners of some faces (f,), one face after the other: (q,) positions in the faces, and (q,) the corners."""
    return expand_ranges(surface.face_start[faces], surface.face_start[faces + 1])


def triangles_of_faces(surface: Surface, faces: Integers) -> tuple[Integers, Integers]:
    """The triangles of some faces (f,), like `corners_of_faces`."""
    order = np.argsort(surface.triangle_face, kind="stable")
    face = surface.triangle_face[order]
    owner, place = expand_ranges(np.searchsorted(face, faces), np.searchsorted(face, faces, "right"))
    return owner, order[place]


def are_joined(values: Floats, first: Integers, second: Integers) -> Booleans:
    """(e,) whether corner values (c, d) are equal on both sides of `adjacent_edges`, up to a tolerance."""
    tolerance = CUT_TOLERANCE * float(np.ptp(values, axis=0).max(initial=0))
    return ~np.asarray((np.abs(values[first] - values[second]) > tolerance).any(axis=(1, 2)))


def cut_surface(surface: Surface, values: Floats) -> CutSurface:
    """Cut a surface along the edges where the two faces' corner values (c, d) differ."""
    first, second = adjacent_edges(surface)
    joined = are_joined(values, first, second)
    first, second = first[joined], second[joined]
    edges = face_edges(surface)
    is_joined = np.zeros(len(edges), dtype=bool)
    for side in (first, second):
        # An edge is numbered by its first corner; sides may have been reversed to match.
        turned = edges[side[:, 0], 1] != side[:, 1]
        is_joined[np.where(turned, side[:, 1], side[:, 0])] = True
    cut_vertex = label_groups(len(edges), first.ravel(), second.ravel())
    face, other = surface.corner_face[first[:, 0]], surface.corner_face[second[:, 0]]
    return CutSurface(surface, cut_vertex, label_groups(len(surface.face_start) - 1, face, other), edges[~is_joined])


def nearer_than(points: Floats, radius: Floats, begin: Floats, end: Floats) -> Booleans:
    """(q,) whether a line segment (s, 3) to (s, 3) may enter the ball of a radius (q,) around each point (q, 3)."""
    if len(begin) == 0:
        return np.zeros(len(points), dtype=bool)
    length = np.linalg.norm(end - begin, axis=1)
    spacing = max(float(np.median(radius)), float(length.sum()) / (4 * len(points) + len(begin)), 1e-300)
    steps = np.ceil(length / spacing).astype(np.int64)
    segment, step = expand_ranges(np.zeros_like(steps), steps + 1)
    along = (step / np.maximum(steps[segment], 1))[:, None]
    reach = radius * 1.001 + spacing / 2
    tree = cKDTree(begin[segment] * (1 - along) + end[segment] * along)
    distance, _ = tree.query(points, distance_upper_bound=1.001 * float(reach.max()), workers=threads())
    return np.asarray(distance <= reach)
