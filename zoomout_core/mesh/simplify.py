# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplify a mesh whose corners have data, in several poses at once, along its seams.

Vertices are merged into neighbours by quadric error (Garland and Heckbert 1997), summed over the poses that the mesh
can take (Mohr and Gleicher 2003), so that more vertices stay where it bends. Borders, seams of the data and borders
between labels are lines: a vertex on a line moves along it, and one where lines meet stays. Each vertex of the
result is a vertex of the mesh, with all of its data. A round makes the cheapest collapses that do not touch each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.runtime.progress import advance
from zoomout_core.tuning import Tuning, tuned

# Share of the possible collapses that a round chooses among, the cheapest ones.
SHARE = 0.3
# Smallest cosine between the normals of a triangle before and after a collapse.
MIN_COSINE = 0.2
# Entries of quadrics, over all vertices and poses; of larger meshes, fewer poses are used.
MAX_QUADRICS = 4_000_000
# Weight of the length of a collapse, to the fourth power as areas times squared errors: it decides where all is flat.
FLAT = 1e-4
# The entries of a symmetric matrix.
ROWS, COLUMNS = np.triu_indices(3)
TWICE = np.where(ROWS == COLUMNS, 1.0, 2.0)


@dataclass(frozen=True)
class SimplificationTuning(Tuning, set_by="production"):
    """How the errors that a collapse makes are weighted.

    Attributes:
        poses: weight of the errors in all other poses, relative to that at rest.
        lines: weight of the distance from borders and seams, relative to that from triangles.
    """

    poses: float = tuned(3.0, "1", 0, 10)
    lines: float = tuned(1.0, "1", 0, 100)


SIMPLIFICATION = SimplificationTuning()


def simplify(
    poses: Floats,
    triangles: Integers,
    layers: Sequence[Integers],
    count: int,
    mirror: Integers | None = None,
    chart: Floats | None = None,
) -> tuple[Integers, Integers]:
    """Reduce a mesh to about `count` vertices.

    Args:
        poses: (p, n, 3) positions in the poses, the first of which is at rest.
        triangles: (m, 3) vertex numbers.
        layers: numbers (m, 3) of the data of each corner, which differ across seams, the most important layer first. If
            the lines leave too many vertices, the last layers are ignored, and then `mirror`.
        count: number of vertices of the result.
        mirror: (n,) the mirror image of each vertex, -1 for none; images are treated alike.
        chart: (m, 3, 2) texture coordinates, whose triangles are not turned over.

    Returns:
        (m',) the triangle that each triangle of the result was, and (m', 3) the corner whose data each of its corners
        has, in the flat list of all corners (3 m).
    """
    used = max(1, min(len(poses), MAX_QUADRICS // max(poses.shape[1], 1)))
    state = _State(poses[:used], triangles, mirror, chart)
    first = max(state.count_vertices(), count + 1)
    for number in range(len(layers), -2, -1):
        if number < 0:
            state.mirror = None
        state.set_layers(layers[: max(number, 0)])
        while state.count_vertices() > count:
            advance(float(np.log(first / state.count_vertices()) / np.log(first / count)))
            if not state.collapse(state.count_vertices() - count):
                break
        else:
            break
    return state.alive, state.corners


class _State:
    """A mesh that is being simplified.

    Attributes:
        triangles: (m', 3) vertex numbers.
        alive: (m',) the number that each triangle had at first.
        corners: (m', 3) the corner whose data each corner has.
    """

    def __init__(self, poses: Floats, triangles: Integers, mirror: Integers | None, chart: Floats | None) -> None:
        centre = poses.mean(axis=1, keepdims=True)
        self.poses = (poses - centre) / max(float(np.ptp(poses[0], axis=0).max()), 1e-30)
        self.weight = np.full(len(poses), SIMPLIFICATION.poses / max(len(poses) - 1, 1))
        self.weight[0] = 1.0
        self.corner_count = triangles.size
        whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        self.alive = np.flatnonzero(whole)
        self.triangles = triangles[whole].copy()
        self.corners = np.arange(triangles.size).reshape(-1, 3)[whole]
        self.mirror = mirror
        self.chart = None if chart is None else chart.reshape(-1, 2)
        self.quadrics = np.zeros((poses.shape[1], len(poses), 10))
        self._add_triangles()
        self.has_lines = False

    def count_vertices(self) -> int:
        """The number of vertices that triangles have."""
        return len(np.unique(self.triangles))

    def set_layers(self, layers: Sequence[Integers]) -> None:
        """Let seams of these layers be lines."""
        self.wedge = np.zeros(self.corner_count, dtype=np.int64)
        for layer in layers:
            pair = np.column_stack([self.wedge, layer.ravel()])
            self.wedge = np.unique(pair, axis=0, return_inverse=True)[1].ravel()
        if not self.has_lines:
            self._add_lines()
            self.has_lines = True

    # --- quadrics -------------------------------------------------------------------------------------------

    def _add_planes(self, vertices: Integers, places: Floats, normals: Floats, weights: Floats) -> None:
        """Add planes through places (k, p, 3) with unit normals (k, p, 3) to the quadrics of vertices (k, c)."""
        offset = -(normals * places).sum(axis=2)
        rows = (
            np.concatenate(
                [
                    normals[..., ROWS] * normals[..., COLUMNS] * TWICE,
                    2 * normals * offset[..., None],
                    offset[..., None] ** 2,
                ],
                axis=2,
            )
            * (weights[:, None] * self.weight)[..., None]
        )
        for corner in vertices.T:
            np.add.at(self.quadrics, corner, rows)

    def _add_triangles(self) -> None:
        normals, areas = self._normals(self.triangles)
        places = self.poses[:, self.triangles[:, 0]].transpose(1, 0, 2)
        self._add_planes(self.triangles, places, normals, areas[:, 0] / 3)

    def _normals(self, triangles: Integers) -> tuple[Floats, Floats]:
        """(k, p, 3) unit normals of triangles (k, 3) in all poses, and (k, p) their areas."""
        a, b, c = (self.poses[:, triangles[:, corner]].transpose(1, 0, 2) for corner in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=2)
        return normal / np.maximum(length, 1e-30)[..., None], length / 2

    def _add_lines(self) -> None:
        """Add planes through borders and seams, at right angles to their triangles."""
        edges = _Edges(self.triangles, self.wedge[self.corners])
        half = edges.is_line[edges.of_half]
        triangle = np.tile(np.arange(len(self.triangles)), 3)[half]
        ends = edges.ends[edges.of_half[half]]
        start, stop = (self.poses[:, ends[:, end]].transpose(1, 0, 2) for end in range(2))
        along = stop - start
        length = np.linalg.norm(along, axis=2)
        normals = np.cross(self._normals(self.triangles[triangle])[0], along / np.maximum(length, 1e-30)[..., None])
        self._add_planes(ends, start, normals, SIMPLIFICATION.lines * length[:, 0] ** 2 / 2)

    def _cost(self, tail: Integers, head: Integers) -> Floats:
        """(k,) the error of merging vertices `tail` into `head`."""
        place = self.poses[:, head].transpose(1, 0, 2)
        powers = np.concatenate([place[..., ROWS] * place[..., COLUMNS], place, np.ones((*place.shape[:2], 1))], axis=2)
        error = np.einsum("kpq,kpq->k", self.quadrics[tail] + self.quadrics[head], powers)
        length = ((self.poses[0, tail] - self.poses[0, head]) ** 2).sum(axis=1)
        return error + FLAT * length**2

    # --- collapses ------------------------------------------------------------------------------------------

    def collapse(self, wanted: int) -> int:
        """Merge up to `wanted` vertices into neighbours; returns their number."""
        edges = _Edges(self.triangles, self.wedge[self.corners])
        tail, head, cost = self._candidates(edges)
        around = _Rings(self.triangles, len(self.quadrics))
        for share in (SHARE, 1.0):
            if not len(tail):
                return 0
            among = np.argsort(cost, kind="stable")[: max(int(np.ceil(share * len(cost))), 1)]
            fits = self._keeps_form(tail[among], head[among], around, edges)
            chosen = among[fits]
            chosen = chosen[self._have_images(tail[chosen], head[chosen])]
            chosen = chosen[self._are_apart(tail[chosen], head[chosen], cost[chosen], around)]
            if len(chosen):
                break
        else:
            return 0
        chosen = self._first_pairs(chosen[np.argsort(cost[chosen], kind="stable")], tail, wanted)
        self._merge(tail[chosen], head[chosen])
        return len(chosen)

    def _first_pairs(self, chosen: Integers, tail: Integers, wanted: int) -> Integers:
        """The first collapses, with the mirror images of all."""
        return chosen[: wanted + 1] if self.mirror is not None and wanted < len(chosen) else chosen[:wanted]

    def _candidates(self, edges: _Edges) -> tuple[Integers, Integers, Floats]:
        """For each vertex that may move the cheapest neighbour to merge it into, and the cost."""
        n = len(self.quadrics)
        lines = np.bincount(edges.ends[edges.is_line].ravel(), minlength=n)
        fixed = np.zeros(n, dtype=bool)
        fixed[edges.ends[edges.is_odd].ravel()] = True
        tail, head = np.concatenate([edges.ends, edges.ends[:, ::-1]]).T
        is_line = np.tile(edges.is_line, 2)
        may = ~fixed[tail] & ((lines[tail] == 0) | is_line)
        if self.mirror is not None:
            on_plane = self.mirror == np.arange(n)
            may &= ~on_plane[tail] | on_plane[head]
            other, goal = self.mirror[tail], self.mirror[head]
            may &= (other < 0) | (goal < 0) | np.isin(other * n + goal, tail * n + head)
        tail, head = tail[may], head[may]
        cost = self._cost(tail, head)
        if self.mirror is not None:
            other, goal = self.mirror[tail], self.mirror[head]
            paired = (other >= 0) & (goal >= 0)
            cost[paired] = (cost[paired] + self._cost(other[paired], goal[paired])) / 2
        order = np.lexsort((self._neutral(head), cost, tail))
        first = np.flatnonzero(np.diff(tail[order], prepend=-1))
        best = order[first]
        return tail[best], head[best], cost[best]

    def _neutral(self, vertex: Integers) -> Integers:
        """Numbers that are equal for a vertex and its mirror image, to decide ties alike on both sides."""
        if self.mirror is None:
            return vertex
        other = self.mirror[vertex]
        return np.where(other >= 0, np.minimum(vertex, other), vertex)

    def _keeps_form(self, tail: Integers, head: Integers, around: _Rings, edges: _Edges) -> Booleans:
        """Whether each collapse keeps topology and seams, and turns no triangle over, in the mesh or its chart."""
        graph = edges.graph(len(self.quadrics))
        shared = np.asarray((graph[tail].multiply(graph[head])).sum(axis=1)).ravel()
        which, triangle = around.of(tail)
        rows = self.triangles[triangle]
        removed = (rows == head[which, None]).any(axis=1)
        removed_count = np.bincount(which[removed], minlength=len(tail))
        fits = (shared == removed_count) & (removed_count > 0) & (around.count(tail) > removed_count)
        which, triangle, rows = which[~removed], triangle[~removed], rows[~removed]
        at_tail = rows == tail[which, None]
        before, areas = self._normals(rows)
        after, now = self._normals(np.where(at_tail, head[which, None], rows))
        turned = ((before * after).sum(axis=2) < MIN_COSINE) & (areas > 0)
        bad = turned.any(axis=1) | (now[:, 0] <= 0)
        corners = self.corners[triangle]
        goal = self._partners(tail, head, around).find(which, self.wedge[(corners * at_tail).sum(axis=1)])
        bad |= goal < 0
        if self.chart is not None:
            moved = np.where(at_tail, goal[:, None], corners)
            bad |= _signed_areas(self.chart[corners]) * _signed_areas(self.chart[moved]) < 0
        fits[which[bad]] = False
        return fits

    def _partners(self, tail: Integers, head: Integers, around: _Rings) -> _Partners:
        """The corners of `head` in the triangles that a collapse removes, by the data of the corner of `tail` there."""
        which, triangle = around.of(tail)
        rows, corners = self.triangles[triangle], self.corners[triangle]
        at_head = rows == head[which, None]
        removed = at_head.any(axis=1)
        which, rows, corners, at_head = which[removed], rows[removed], corners[removed], at_head[removed]
        of_tail = (corners * (rows == tail[which, None])).sum(axis=1)
        return _Partners(
            which, self.wedge[of_tail], (corners * at_head).sum(axis=1), int(self.wedge.max(initial=0)) + 1
        )

    def _are_apart(self, tail: Integers, head: Integers, cost: Floats, around: _Rings) -> Integers:
        """The collapses that are cheaper than all that touch them; mirror images must both be."""
        neutral = self._neutral(tail)
        rank = np.empty(len(tail), dtype=np.int64)
        order = np.lexsort((neutral, cost))
        # Mirror images share a rank, which their sides decide by equal keys.
        new = np.ones(len(order), dtype=bool)
        new[1:] = (cost[order][1:] != cost[order][:-1]) | (neutral[order][1:] != neutral[order][:-1])
        rank[order] = np.cumsum(new)
        which, triangle = around.of(tail)
        touched = self.triangles[triangle].ravel()
        owner = np.repeat(which, 3)
        n = len(self.quadrics)
        best = np.full(n, np.iinfo(np.int64).max)
        np.minimum.at(best, touched, rank[owner])
        wins = np.ones(len(tail), dtype=bool)
        wins[owner[best[touched] < rank[owner]]] = False
        # Two of the same rank are mirror images, which may have a vertex of the plane in common, but no triangle.
        own = wins[which]
        several = np.bincount(triangle[own], minlength=len(self.triangles)) > 1
        wins[which[own & several[triangle]]] = False
        chosen = np.flatnonzero(wins)
        return chosen[self._have_images(tail[chosen], head[chosen])]

    def _have_images(self, tail: Integers, head: Integers) -> Booleans:
        """Whether the mirror image of each collapse is among them; true for those without an image."""
        if self.mirror is None:
            return np.ones(len(tail), dtype=bool)
        goal = np.full(len(self.quadrics), -1)
        goal[tail] = head
        other = self.mirror[tail]
        return (other < 0) | (goal[other] == self.mirror[head])

    def _merge(self, tail: Integers, head: Integers) -> None:
        around = _Rings(self.triangles, len(self.quadrics))
        which, triangle = around.of(tail)
        rows = self.triangles[triangle]
        at_tail = rows == tail[which, None]
        partners = self._partners(tail, head, around)
        goal = partners.find(which, self.wedge[(self.corners[triangle] * at_tail).sum(axis=1)])
        self.triangles[triangle] = np.where(at_tail, head[which, None], rows)
        self.corners[triangle] = np.where(at_tail, goal[:, None], self.corners[triangle])
        self.quadrics[head] += self.quadrics[tail]
        whole = (self.triangles != np.roll(self.triangles, 1, axis=1)).all(axis=1)
        self.triangles, self.corners, self.alive = self.triangles[whole], self.corners[whole], self.alive[whole]


class _Partners:
    """Corners by collapse and by the data of another corner."""

    def __init__(self, which: Integers, wedge: Integers, corner: Integers, wedges: int) -> None:
        key = which * wedges + wedge
        order = np.argsort(key, kind="stable")
        self.key, self.corner, self.wedges = key[order], corner[order], wedges

    def find(self, which: Integers, wedge: Integers) -> Integers:
        """(k,) the corner for each collapse and data, -1 for none."""
        key = which * self.wedges + wedge
        at = np.minimum(np.searchsorted(self.key, key), max(len(self.key) - 1, 0))
        return np.where(self.key[at] == key, self.corner[at], -1) if len(self.key) else np.full(len(key), -1)


class _Rings:
    """The triangles around each vertex."""

    def __init__(self, triangles: Integers, count: int) -> None:
        flat = triangles.ravel()
        self.order = np.argsort(flat, kind="stable") // 3
        self.start = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=count))])

    def count(self, vertices: Integers) -> Integers:
        """(k,) the number of triangles at each vertex."""
        return self.start[vertices + 1] - self.start[vertices]

    def of(self, vertices: Integers) -> tuple[Integers, Integers]:
        """The place in the list (k,) of each triangle's vertex, and the triangle."""
        count = self.count(vertices)
        which = np.repeat(np.arange(len(vertices)), count)
        within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        return which, self.order[self.start[vertices][which] + within]


class _Edges:
    """The edges of triangles (m, 3) whose corners have data (m, 3).

    Attributes:
        ends: (e, 2) vertex numbers, the smaller first.
        of_half: (3 m,) the edge of each side of the triangles: all first sides, then all second and third ones.
        is_line: (e,) whether it is a border or a seam.
        is_odd: (e,) whether it has more than two triangles.
    """

    def __init__(self, triangles: Integers, wedge: Integers) -> None:
        tail = triangles.T.ravel()
        head = np.roll(triangles, -1, axis=1).T.ravel()
        sides = np.column_stack([np.minimum(tail, head), np.maximum(tail, head)])
        of_tail, of_head = wedge.T.ravel(), np.roll(wedge, -1, axis=1).T.ravel()
        swapped = tail > head
        low, high = np.where(swapped, of_head, of_tail), np.where(swapped, of_tail, of_head)
        key = sides[:, 0] * (int(sides.max(initial=0)) + 1) + sides[:, 1]
        _, first, self.of_half, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
        self.of_half = self.of_half.ravel()
        self.ends = sides[first]
        differs = (low != low[first][self.of_half]) | (high != high[first][self.of_half])
        self.is_line = count == 1
        self.is_line[self.of_half[differs]] = True
        self.is_odd = count > 2

    def graph(self, count: int) -> csr_array:
        """(count, count) ones where vertices are neighbours."""
        both = np.concatenate([self.ends, self.ends[:, ::-1]])
        return coo_array((np.ones(len(both)), both.T), shape=(count, count)).tocsr()


def _signed_areas(triangles: Floats) -> Floats:
    """(k,) signed areas, twice, of triangles (k, 3, 2)."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
