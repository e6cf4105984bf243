# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh whose edges are collapsed in rounds, the cheapest ones first.

A round makes collapses that do not touch each other, and keeps topology, seams, regions and mirror images. No collapse
folds the surface: quadrics alone let the two sides of a thin part, such as a toe, merge into one sheet.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.adjacency import Edges, Lists, group_by_key
from zoomout_core.mesh.simplification.collapses import Candidates, Costs, Partners, combine_layers
from zoomout_core.mesh.simplification.diagonals import flip_diagonals
from zoomout_core.mesh.simplification.folds import MovedTriangles, find_folds
from zoomout_core.mesh.simplification.quadrics import Quadrics
from zoomout_core.mesh.triangles import signed_areas

# Share of the possible collapses that a round chooses among, the cheapest ones.
SHARE = 0.3
# Times that a round chooses among the collapses that touch none of those chosen before.
PASSES = 4
# Smallest cosine between the normals of a triangle before and after a collapse.
MIN_COSINE = 0.2
# Triangles that each protected region keeps.
KEPT_TRIANGLES = 2


class CollapsingMesh:
    """A mesh whose edges are collapsed step by step.

    Attributes:
        triangles: (m', 3) vertex numbers.
        region: (m',) the regions of the triangles.
        spare: (r,) how many triangles each region can lose.
        alive: (m',) the number that each triangle had at first.
        corners: (m', 3) the corner at whose first vertex each corner is.
        content: (m', 3) the corner whose data each corner has.
        normals: (m', 3) the unit normals of the triangles at rest.
        charts: (m, 3) numbers of the data that stays within its seams, see `simplify`.
        wedge: (3 m,) numbers of the data whose seams are lines, of the corners.
        content_wedge: (3 m,) those of this data and `charts` together.
        mirror: (n,) the mirror image of each vertex, -1 for none; None if images are treated independently.
        uv: (3 m, 2) texture coordinates of the corners; None if there are none.
        first: `triangles` and `corners` before any collapse.
        known: the costs of collapses that are known from earlier rounds.
        distance: the limit of the distance by which collapses move vertices, see `Quadrics.costs`.
        into: (n,) the vertex that each vertex was merged into.
        changed: (n,) vertices whose quadrics have changed since the last round.
        touched: (n,) vertices whose triangles have changed since the last round.
    """

    def __init__(
        self,
        poses: Floats,
        triangles: Integers,
        charts: Integers,
        mirror: Integers | None,
        uv: Floats | None,
        regions: Integers | None,
    ) -> None:
        self.quadrics, self.vertex_count = Quadrics(poses), poses.shape[1]
        self.corner_count, self.vertex_of_corner = triangles.size, triangles.ravel()
        whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        self.alive = np.flatnonzero(whole)
        self.triangles = triangles[whole].copy()
        self.region = np.zeros(whole.sum(), dtype=np.int64) if regions is None else regions[whole]
        self.corners = np.arange(triangles.size).reshape(-1, 3)[whole]
        self.content, self.charts = self.corners.copy(), charts
        self.mirror = None if mirror is None else mirror.copy()
        self.uv = None if uv is None else uv.reshape(-1, 2)
        self.first = self.triangles.copy(), self.corners.copy()
        self.into = np.arange(self.vertex_count)

    def guard_regions(self, count: int) -> None:
        """Protect the first `count` regions, which are the most important ones, and no others, from vanishing."""
        self.spare = np.bincount(self.region)
        self.spare[:count] = np.maximum(self.spare[:count] - KEPT_TRIANGLES, 0)
        self.touched[:] = True  # as other collapses may be possible

    def count_vertices(self) -> int:
        """The number of vertices that triangles have."""
        return int(np.count_nonzero(np.bincount(self.triangles.ravel())))

    def set_lines(self, layers: Sequence[Integers], distance: float) -> None:
        """Treat seams of these layers as lines, and limit the distance by which collapses move vertices.

        Quadrics are summed again, without the lines of other layers.
        """
        self.distance, self.wedge = distance, combine_layers(layers, self.corner_count)
        self.content_wedge = combine_layers([*layers, self.charts], self.corner_count)
        triangles, corners = self.first
        self.quadrics.sum_planes(triangles, Edges(triangles, self.wedge[corners], self.vertex_count), self.into)
        self.known = Costs(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2), dtype=bool))
        self.changed = self.touched = np.ones(self.vertex_count, dtype=bool)

    def mirror_diagonals(self, layers: Sequence[Integers]) -> None:
        """Make the edges as symmetric as the vertices, because edges without a mirror image are never collapsed.

        Ends of edges that still have no image, or a seam of the layers on one side only, are treated independently.
        """
        if self.mirror is None:
            return
        wedge, places = combine_layers(layers, self.corner_count), self.quadrics.places[:, 0]
        self.corners = flip_diagonals(self.triangles, self.corners, wedge, self.mirror, places, self.uv)
        self.triangles = self.vertex_of_corner[self.corners]
        self.content = self.corners.copy()
        self.first = self.triangles.copy(), self.corners.copy()
        edges = Edges(self.triangles, wedge[self.corners], self.vertex_count)
        image = np.where(self.mirror[edges.ends].min(axis=1) >= 0, edges.find(*self.mirror[edges.ends].T), -1)
        uneven = (image < 0) | (edges.is_line != edges.is_line[image])
        self._unpair(edges.ends[uneven].ravel())

    def _unpair(self, vertices: Integers) -> None:
        """Treat vertices and their mirror images independently from now on; -1 is ignored."""
        assert self.mirror is not None
        vertices = vertices[vertices >= 0]
        images = self.mirror[vertices]
        self.mirror[images[images >= 0]] = -1
        self.mirror[vertices] = -1

    def ignore_mirror(self) -> None:
        """Treat mirror images independently from now on."""
        self.mirror = None
        self.changed = self.touched = np.ones(self.vertex_count, dtype=bool)

    def collapse(self, wanted: int) -> int:
        """Merge up to `wanted` vertices into neighbours; returns their number."""
        edges = Edges(self.triangles, self.wedge[self.corners], self.vertex_count)
        corner, start = group_by_key(self.triangles.ravel(), self.vertex_count)
        around = Lists(corner // 3, start)
        self._update_costs(edges)
        directions = self._free_directions(edges)
        self.normals = self.quadrics.normals(self.triangles, slice(0, 1))[0][:, 0]
        while True:
            candidates = self._candidates(edges, directions)
            if not len(candidates.tail):
                return 0
            chosen = self._choose(candidates, edges, around)
            if len(chosen):
                break
        chosen = self._first_pairs(chosen[np.argsort(candidates.cost[chosen], kind="stable")], wanted)
        self._merge(candidates.tail[chosen], candidates.head[chosen], around)
        return len(chosen)

    def _first_pairs(self, chosen: Integers, wanted: int) -> Integers:
        """The first collapses, with the mirror images of all."""
        return chosen[: wanted + 1] if self.mirror is not None and wanted < len(chosen) else chosen[:wanted]

    def _update_costs(self, edges: Edges) -> None:
        """Compute the costs of edges that are new or whose ends changed, in both directions."""
        cost = np.empty((len(edges.ends), 2))
        fails = np.zeros((len(edges.ends), 2), dtype=bool)
        before = self.known.find(edges.key)
        kept = before >= 0
        same = kept & ~self.touched[edges.ends].any(axis=1)
        fails[same] = self.known.fails[before[same]]
        kept &= ~self.changed[edges.ends].any(axis=1)
        cost[kept] = self.known.cost[before[kept]]
        new = np.flatnonzero(~kept)
        for direction in range(2):
            tail, head = edges.ends[new, direction], edges.ends[new, 1 - direction]
            value = self.quadrics.costs(tail, head, self.distance)
            if self.mirror is not None:
                other, goal = self.mirror[tail], self.mirror[head]
                paired = np.flatnonzero((other >= 0) & (goal >= 0))
                other, goal = other[paired], goal[paired]
                value[paired] = (value[paired] + self.quadrics.costs(other, goal, self.distance)) / 2
                value[paired[edges.find(other, goal) < 0]] = np.inf
            cost[new, direction] = value
        self.known = Costs(edges.key, cost, fails)
        self.changed = np.zeros(self.vertex_count, dtype=bool)
        self.touched = np.zeros(self.vertex_count, dtype=bool)

    def _free_directions(self, edges: Edges) -> Booleans:
        """(e, 2) whether lines and the plane of symmetry allow a collapse from the first or second end of an edge."""
        n = self.vertex_count
        on_line = np.zeros(n, dtype=bool)
        on_line[edges.ends[edges.is_line]] = True
        fixed = np.zeros(n, dtype=bool)
        fixed[edges.ends[edges.is_odd]] = True
        may = ~fixed[edges.ends] & (~on_line[edges.ends] | edges.is_line[:, None])
        if self.mirror is not None:
            on_plane = (self.mirror == np.arange(n))[edges.ends]
            may &= ~on_plane | on_plane[:, ::-1]
        return may

    def _candidates(self, edges: Edges, directions: Booleans) -> Candidates:
        """For each vertex that may move the cheapest neighbour to merge it into, the cheapest collapse first."""
        cost = np.where(directions & ~self.known.fails, self.known.cost, np.inf)
        direction, edge = np.divmod(np.flatnonzero(np.isfinite(cost.T.ravel())), len(cost))
        tail, head, cost = edges.ends[edge, direction], edges.ends[edge, 1 - direction], cost[edge, direction]
        order, _ = group_by_key(tail, self.vertex_count)
        tail, head, cost, place = tail[order], head[order], cost[order], 2 * edge[order] + direction[order]
        for step in range(3 if len(tail) else 0):
            start = np.flatnonzero(np.diff(tail, prepend=-1))
            key = (cost, self._neutral(head), head)[step]
            best = key == np.repeat(np.minimum.reduceat(key, start), np.diff(start, append=len(key)))
            tail, head, cost, place = tail[best], head[best], cost[best], place[best]
        neutral = self._neutral(tail)
        order = np.lexsort((neutral, cost))
        # Mirror images share a rank, which their sides decide by equal keys.
        same = (np.diff(cost[order]) == 0) & (np.diff(neutral[order]) == 0)
        rank = np.concatenate([[0], np.cumsum(~same)])[: len(order)]
        return Candidates(tail[order], head[order], cost[order], rank, place[order])

    def _neutral(self, vertex: Integers) -> Integers:
        """Numbers that are equal for a vertex and its mirror image, to decide ties alike on both sides."""
        if self.mirror is None:
            return vertex
        other = self.mirror[vertex]
        return np.where(other >= 0, np.minimum(vertex, other), vertex)

    def _choose(self, among: Candidates, edges: Edges, around: Lists) -> Integers:
        """Numbers of cheap collapses that do not touch each other. Impossible ones are marked."""
        tail, head, rank = among.tail, among.head, among.rank
        count = max(int(np.ceil(SHARE * len(tail))), 1)
        which, triangle = around.of(tail[:count])
        # The cheapest collapse is the last, so that assignments keep its rank.
        owner, vertex = np.repeat(which, 3)[::-1], self.triangles[triangle].ravel()[::-1]
        best = np.empty(self.vertex_count, dtype=np.int64)
        taken = np.zeros(self.vertex_count, dtype=bool)
        free = np.ones(count, dtype=bool)
        chosen = np.zeros(0, dtype=np.int64)
        for _ in range(PASSES):
            best[vertex] = rank[owner]
            wins = free.copy()
            wins[owner[best[vertex] < rank[owner]]] = False
            winners = np.flatnonzero(wins)
            fits = self._keeps_form(tail[winners], head[winners], around, edges)
            # Two of the same rank are mirror images, which may have a vertex of the plane in common, but no triangle.
            which, triangle = around.of(tail[winners])
            several = np.bincount(triangle, minlength=len(self.triangles)) > 1
            fits[which[several[triangle]]] = False
            self.known.fails.ravel()[among.place[winners[~fits]]] = True
            free[winners] = False
            fitting = winners[fits]
            fitting = fitting[self._have_images(tail[fitting], head[fitting])]
            if not len(fitting) and not len(chosen):
                self.known.fails.ravel()[among.place[winners]] = True
            chosen = np.concatenate([chosen, fitting])
            taken[self.triangles[around.of(tail[fitting])[1]]] = True
            free[owner[taken[vertex]]] = False
            owner, vertex = owner[free[owner]], vertex[free[owner]]
            if not len(owner):
                break
        return self._keep_regions(chosen, among, around)

    def _keep_regions(self, chosen: Integers, among: Candidates, around: Lists) -> Integers:
        """Those of the chosen collapses that together leave enough triangles of each region, the cheapest first."""
        chosen = np.sort(chosen)
        which, triangle = around.of(among.tail[chosen])
        removed = (self.triangles[triangle] == among.head[chosen[which], None]).any(axis=1)
        collapse, region = which[removed], self.region[triangle[removed]]
        order = np.argsort(region, kind="stable")
        collapse, region = collapse[order], region[order]
        place = np.arange(len(region)) - np.searchsorted(region, region)
        # Mirror images, which have the same rank, are left out together.
        rank = among.rank[chosen]
        left_out = np.isin(rank, rank[collapse[place >= self.spare[region]]])
        if left_out.all():
            self.known.fails.ravel()[among.place[chosen]] = True
        return chosen[~left_out]

    def _keeps_form(self, tail: Integers, head: Integers, around: Lists, edges: Edges) -> Booleans:
        """Whether each collapse keeps topology and seams, and turns no triangle over, in the mesh or its UV map."""
        which, triangle = around.of(tail)
        rows = self.triangles[triangle]
        removed = (rows == head[which, None]).any(axis=1)
        removed_count = np.bincount(which[removed], minlength=len(tail))
        fits = (
            (edges.count_common(tail, head) == removed_count)
            & (removed_count > 0)
            & (around.count(tail) > removed_count)
        )
        lost, count = np.unique(which[removed] * len(self.spare) + self.region[triangle[removed]], return_counts=True)
        collapse, region = np.divmod(lost, len(self.spare))
        fits[collapse[count > self.spare[region]]] = False
        which, triangle, rows = which[~removed], triangle[~removed], rows[~removed]
        at_tail = rows == tail[which, None]
        before, areas = self.quadrics.normals(rows)
        after, now = self.quadrics.normals(np.where(at_tail, head[which, None], rows))
        turned = (np.einsum("kpx,kpx->kp", before, after) < MIN_COSINE) & (areas > 0)
        bad = turned.any(axis=1) | (now[:, 0] <= 0)
        own = (self.corners[triangle] * at_tail).sum(axis=1)
        bad |= self._partners(tail, head, around, self.corners, self.wedge).find(which, self.wedge[own]) < 0
        moved = MovedTriangles(which, triangle, after[:, 0])
        bad |= find_folds(tail, head, moved, self.triangles, self.normals, edges)
        if self.uv is not None:
            content = self.content[triangle]
            content_after = self._move_content(tail, head, around, which, content, at_tail)
            bad |= signed_areas(self.uv[content]) * signed_areas(self.uv[content_after]) < 0
        fits[which[bad]] = False
        return fits

    def _move_content(
        self, tail: Integers, head: Integers, around: Lists, which: Integers, content: Integers, at_tail: Booleans
    ) -> Integers:
        """The content (k, 3) of triangles after collapses `which`. Across a seam, they keep the content of the tail."""
        own = (content * at_tail).sum(axis=1)
        goal = self._partners(tail, head, around, self.content, self.content_wedge).find(which, self.content_wedge[own])
        return np.where(at_tail, np.where(goal < 0, own, goal)[:, None], content)

    def _partners(self, tail: Integers, head: Integers, around: Lists, corners: Integers, wedge: Integers) -> Partners:
        """The corners of `head` in the triangles that a collapse removes, by the data of the corner of `tail` there."""
        which, triangle = around.of(tail)
        rows, corners = self.triangles[triangle], corners[triangle]
        at_head = rows == head[which, None]
        removed = at_head.any(axis=1)
        which, rows, corners, at_head = which[removed], rows[removed], corners[removed], at_head[removed]
        of_tail = (corners * (rows == tail[which, None])).sum(axis=1)
        return Partners(which, wedge[of_tail], (corners * at_head).sum(axis=1), int(wedge.max(initial=0)) + 1)

    def _have_images(self, tail: Integers, head: Integers) -> Booleans:
        """Whether the mirror image of each collapse is among them; true for those without an image."""
        if self.mirror is None:
            return np.ones(len(tail), dtype=bool)
        goal = np.full(self.vertex_count, -1)
        goal[tail] = head
        other = self.mirror[tail]
        return (other < 0) | (goal[other] == self.mirror[head])

    def _merge(self, tail: Integers, head: Integers, around: Lists) -> None:
        which, triangle = around.of(tail)
        rows = self.triangles[triangle]
        at_tail = rows == tail[which, None]
        partners = self._partners(tail, head, around, self.corners, self.wedge)
        goal = partners.find(which, self.wedge[(self.corners[triangle] * at_tail).sum(axis=1)])
        content = self._move_content(tail, head, around, which, self.content[triangle], at_tail)
        self.triangles[triangle] = np.where(at_tail, head[which, None], rows)
        self.corners[triangle] = np.where(at_tail, goal[:, None], self.corners[triangle])
        self.content[triangle] = content
        self.quadrics.merge(tail, head)
        goal = np.arange(len(self.into))
        goal[tail] = head
        self.into = goal[self.into]
        self.changed[head] = True
        self.touched[rows] = True
        if self.mirror is not None:
            self._unpair(np.setdiff1d(self.mirror[tail], tail))  # images of vertices that are gone without theirs
            for marks in (self.changed, self.touched):
                other = self.mirror[np.flatnonzero(marks)]
                marks[other[other >= 0]] = True
        whole = (self.triangles != np.roll(self.triangles, 1, axis=1)).all(axis=1)
        self.spare -= np.bincount(self.region[~whole], minlength=len(self.spare))
        self.triangles, self.alive, self.region = self.triangles[whole], self.alive[whole], self.region[whole]
        self.corners, self.content = self.corners[whole], self.content[whole]
