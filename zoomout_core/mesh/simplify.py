# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplify a mesh whose corners have data, in several poses at once, along its seams.

Vertices are merged into neighbours in the order of their quadric errors (Garland and Heckbert 1997). Errors are summed
over the poses of the mesh (Mohr and Gleicher 2003), so that more vertices stay where it bends. Borders, seams of the
data and borders between labels are lines: a vertex on a line moves along it, and one where lines meet stays. Each
vertex of the result is a vertex of the mesh, with all of its data. If lines must be ignored, a corner that moves across
a seam keeps its own data, such as texture coordinates, so that no triangle mixes two charts. Small regions of a label,
such as eyes, do not vanish. No collapse folds the surface: quadrics alone let the two sides of a thin part, such as a
toe, merge into one sheet. A round makes cheap collapses that do not touch each other, and only costs of edges that
these change are recomputed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers, take_rows
from zoomout_core.mesh.adjacency import Edges, Lists, Quads, group_by_key
from zoomout_core.mesh.triangles import cross
from zoomout_core.runtime.progress import advance
from zoomout_core.tuning import Tuning, tuned

# Share of the possible collapses that a round chooses among, the cheapest ones.
SHARE = 0.3
# Times that a round chooses among the collapses that touch none of those chosen before.
PASSES = 4
# Smallest cosine between the normals of a triangle before and after a collapse.
MIN_COSINE = 0.2
# Smallest opening between triangles with a common edge that a collapse may make: one plus the cosine between their
# normals, 0 where they are folded onto each other. 0.2 is an angle of 37 degrees inside a solid.
MIN_OPENING = 0.2
# Where the mesh is folded more sharply, the share of the smallest opening at a vertex that its collapse keeps.
KEPT_OPENING = 0.5
# The opening between triangles of a plane.
FLAT_OPENING = 2.0
# Regions that do not vanish: their largest number, relative to the vertices of the result, and the triangles of each.
REGIONS, KEPT_TRIANGLES = 0.125, 2
# Root mean square distances from their planes, relative to the extent, by which collapses may move vertices: at first,
# and once the least important layer is ignored. Farther ones would destroy parts.
DISTANCES = (0.01, 0.02)
# Entries of quadrics that are processed together, to bound the memory.
BLOCK = 1 << 19
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
    counts: Sequence[int],
    mirror: Integers | None = None,
    uv: Floats | None = None,
    charts: Integers | None = None,
    regions: Integers | None = None,
) -> list[tuple[Integers, Integers, Integers]]:
    """Reduce a mesh step by step, to about the given numbers of vertices.

    Args:
        poses: (p, n, 3) positions in the poses, the first of which is at rest.
        triangles: (m, 3) vertex numbers.
        layers: numbers (m, 3) of the data of each corner, which differ across seams, the most important layer first. If
            the lines leave too many vertices, the last layers are ignored, and then `mirror`, see `DISTANCES`.
        counts: numbers of vertices of the results, the largest first.
        mirror: (n,) the mirror image of each vertex, -1 for none; images are treated alike.
        uv: (m, 3, 2) texture coordinates, whose triangles are not turned over.
        charts: (m, 3) numbers of the data that each corner keeps when it moves across a seam that is not a line; those
            of the first layer, when not given.
        regions: (m,) numbers of regions that do not vanish, such as eyes, the most important first, see `REGIONS`;
            none when not given.

    Returns:
        Three arrays for each count: (m',) the original triangle of each triangle of the result, (m', 3) an original
            corner at the vertex of each of its corners, and (m', 3) the original corner that each takes its data from.
            Corners are numbers in the flat list of all corners (3 m). The last two differ where a triangle reaches
            across a seam of `charts` that is not a line.
    """
    if charts is None:
        charts = layers[0] if len(layers) else np.zeros_like(triangles)
    state = _State(poses, triangles, charts, mirror, uv, regions)
    fewer = max(len(layers) - 1, 0)
    steps = [(fewer, DISTANCES[0]), *((kept, DISTANCES[1]) for kept in range(fewer, -1, -1))]
    state.mirror_diagonals(layers)
    state.set_lines(layers, DISTANCES[0])
    first = max(state.count_vertices(), counts[0] + 1)
    found = []
    for count in counts:
        state.guard_regions(0 if regions is None else int(REGIONS * count))
        while (now := state.count_vertices()) > count:
            advance(float(np.log(first / now) / np.log(first / counts[-1])))
            if state.collapse(now - count):
                continue
            if state.mirror is None and not steps:
                break
            if steps:
                kept, distance = steps.pop(0)
                state.set_lines(layers[:kept], distance)
            else:
                state.ignore_mirror()
        found.append((state.alive, state.corners.copy(), state.content.copy()))
    return found


class _State:
    """A mesh that is being simplified.

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
        centre = poses.mean(axis=1, keepdims=True)
        size = max(float(np.ptp(poses[0], axis=0).max()), 1e-30)
        self.places = np.ascontiguousarray(((poses - centre) / size).transpose(1, 0, 2))  # (n, p, 3)
        self.weight = np.full(len(poses), SIMPLIFICATION.poses / max(len(poses) - 1, 1))
        self.weight[0] = 1.0
        self.corner_count, self.vertex_of_corner = triangles.size, triangles.ravel()
        whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        self.alive = np.flatnonzero(whole)
        self.triangles = triangles[whole].copy()
        self.region = np.zeros(whole.sum(), dtype=np.int64) if regions is None else regions[whole]
        self.corners = np.arange(triangles.size).reshape(-1, 3)[whole]
        self.content, self.charts = self.corners.copy(), charts
        self.mirror = None if mirror is None else mirror.copy()
        self.uv = None if uv is None else uv.reshape(-1, 2)
        # The mesh at first, and the vertex that each vertex was merged into.
        self.first = self.triangles.copy(), self.corners.copy()
        self.into = np.arange(len(self.places))

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
        self.distance, self.wedge = distance, self._combine(layers)
        self.content_wedge = self._combine([*layers, self.charts])
        self.quadrics = np.zeros((*self.places.shape[:2], 10))
        self._add_triangles()
        self._add_lines()
        everything = np.arange(len(self.quadrics))
        self.own = self._products(everything, everything)
        # The areas of the planes, in the sum over the poses: traces of the quadrics.
        self.area = self.quadrics[..., :6][..., ROWS == COLUMNS].sum(axis=(1, 2))
        self.known = _Costs(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2), dtype=bool))
        self.changed = self.touched = np.ones(len(self.quadrics), dtype=bool)

    def _combine(self, layers: Sequence[Integers]) -> Integers:
        """(3 m,) numbers of the data of the corners in all of these layers (m, 3)."""
        wedge = np.zeros(self.corner_count, dtype=np.int64)
        for layer in layers:
            key = wedge * (int(layer.max(initial=0)) + 1) + layer.ravel()
            wedge = np.unique(key, return_inverse=True)[1].ravel()
        return wedge

    def mirror_diagonals(self, layers: Sequence[Integers]) -> None:
        """Make the edges as symmetric as the vertices, because edges without a mirror image are never collapsed.

        If an image is missing because the quad there is divided along its other diagonal, the longer of the two
        diagonals is flipped. Programs divide quads alike on both sides. Ends of edges that still have no image, or a
        seam of the layers on one side only, are treated independently.
        """
        if self.mirror is None:
            return
        wedge = self._combine(layers)
        edges = Edges(self.triangles, wedge[self.corners], len(self.places))
        quads = Quads(self.triangles, edges)
        image = self.mirror[quads.vertices]
        paired = np.flatnonzero((image >= 0).all(axis=1))
        image = image[paired]
        other = edges.find(image[:, 1], image[:, 3])
        missing = (edges.find(image[:, 0], image[:, 2]) < 0) & (other >= 0)
        one, other = paired[missing], quads.of_edge[other[missing]]
        there = np.sort(quads.vertices[other][:, 1::2], axis=1)
        same = (other >= 0) & (one < other) & (there == np.sort(image[missing][:, ::2], axis=1)).all(axis=1)
        one, other = one[same], other[same]
        ends = self.places[quads.vertices[:, ::2], 0]
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        flipped = np.where(length[one] > length[other], one, other)
        flipped = flipped[quads.touch_once(flipped, len(self.triangles))]
        first, second = quads.triangles[flipped].T
        a, b, c, d = (quads.corners_of(self.corners, flipped)[:, place] for place in range(4))
        if self.uv is not None:
            areas = [_signed_areas(self.uv[np.stack(each, axis=1)]) for each in ((a, b, d), (b, c, d))]
            before = _signed_areas(self.uv[np.stack((a, c, d), axis=1)])
            kept = (areas[0] * before > 0) & (areas[1] * before > 0)
            first, second, a, b, c, d = (each[kept] for each in (first, second, a, b, c, d))
        for triangle, corners in ((first, (a, b, d)), (second, (b, c, d))):
            self.corners[triangle] = np.stack(corners, axis=1)
        self.triangles = self.vertex_of_corner[self.corners]
        self.content = self.corners.copy()
        self.first = self.triangles.copy(), self.corners.copy()
        edges = Edges(self.triangles, wedge[self.corners], len(self.places))
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
        self.changed = self.touched = np.ones(len(self.quadrics), dtype=bool)

    # --- quadrics -------------------------------------------------------------------------------------------

    def _add_planes(self, pose: int, vertices: Integers, places: Floats, normals: Floats, weights: Floats) -> None:
        """Add planes in a pose through places (k, 3) with unit normals (k, 3) to the quadrics of vertices (k, c)."""
        offset = -(normals * places).sum(axis=1)[:, None]
        rows = np.hstack([normals[:, ROWS] * normals[:, COLUMNS] * TWICE, 2 * normals * offset, offset**2])
        rows *= (weights * self.weight[pose])[:, None]
        count, corners = vertices.shape
        start = np.arange(0, count * corners + 1, corners)
        shape = count, len(self.quadrics)
        incidence = csr_array((np.ones(vertices.size), self.into[vertices].ravel(), start), shape=shape)
        self.quadrics[:, pose] += incidence.T @ rows

    def _add_triangles(self) -> None:
        triangles, _ = self.first
        areas = self._normals(triangles, slice(0, 1))[1][:, 0]
        for pose in range(len(self.weight)):
            normals, _ = self._normals(triangles, slice(pose, pose + 1))
            self._add_planes(pose, triangles, self.places[triangles[:, 0], pose], normals[:, 0], areas / 3)

    def _normals(self, triangles: Integers, poses: slice = slice(None)) -> tuple[Floats, Floats]:
        """(k, p, 3) unit normals of triangles (k, 3) in poses, and (k, p) their areas."""
        a, b, c = (self.places[triangles[:, corner], poses] for corner in range(3))
        normal = cross(b - a, c - a)
        length = np.sqrt(np.einsum("kpx,kpx->kp", normal, normal))
        normal /= np.maximum(length, 1e-30)[..., None]
        return normal, length / 2

    def _add_lines(self) -> None:
        """Add planes through borders and seams, at right angles to their triangles."""
        triangles, corners = self.first
        edges = Edges(triangles, self.wedge[corners], len(self.quadrics))
        half = np.flatnonzero(edges.is_line[edges.of_half])
        triangles, ends = triangles[half % len(triangles)], edges.ends[edges.of_half[half]]
        squared = ((self.places[ends[:, 1], 0] - self.places[ends[:, 0], 0]) ** 2).sum(axis=1)
        for pose in range(len(self.weight)):
            start, stop = self.places[ends[:, 0], pose], self.places[ends[:, 1], pose]
            normals = cross(self._normals(triangles, slice(pose, pose + 1))[0][:, 0], stop - start)
            normals /= np.maximum(np.linalg.norm(stop - start, axis=1), 1e-30)[:, None]
            self._add_planes(pose, ends, start, normals, SIMPLIFICATION.lines * squared / 2)

    def _products(self, one: Integers, other: Integers) -> Floats:
        """(k,) the errors of the quadrics of vertices `one` at the places of vertices `other`."""
        step = max(1, BLOCK // self.quadrics[0].size)
        error = np.empty(len(one))
        for start in range(0, len(one), step):
            block = slice(start, start + step)
            place = take_rows(self.places, other[block])
            powers = np.empty((*place.shape[:2], 10))
            np.multiply(place[..., ROWS], place[..., COLUMNS], out=powers[..., :6])
            powers[..., 6:9] = place
            powers[..., 9] = 1
            error[block] = np.einsum("kpq,kpq->k", take_rows(self.quadrics, one[block]), powers)
        return error

    def _cost(self, tail: Integers, head: Integers) -> Floats:
        """(k,) the error of merging vertices `tail` into `head`, infinite if it would destroy a part."""
        length = ((self.places[tail, 0] - self.places[head, 0]) ** 2).sum(axis=1)
        error = self._products(tail, head) + self.own[head]
        error[error > self.distance**2 * (self.area[tail] + self.area[head])] = np.inf
        return error + FLAT * length**2

    # --- collapses ------------------------------------------------------------------------------------------

    def collapse(self, wanted: int) -> int:
        """Merge up to `wanted` vertices into neighbours; returns their number."""
        edges = Edges(self.triangles, self.wedge[self.corners], len(self.quadrics))
        corner, start = group_by_key(self.triangles.ravel(), len(self.quadrics))
        around = Lists(corner // 3, start)
        self._update_costs(edges)
        directions = self._free_directions(edges)
        self.normals = self._normals(self.triangles, slice(0, 1))[0][:, 0]
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
            value = self._cost(tail, head)
            if self.mirror is not None:
                other, goal = self.mirror[tail], self.mirror[head]
                paired = np.flatnonzero((other >= 0) & (goal >= 0))
                other, goal = other[paired], goal[paired]
                value[paired] = (value[paired] + self._cost(other, goal)) / 2
                value[paired[edges.find(other, goal) < 0]] = np.inf
            cost[new, direction] = value
        self.known = _Costs(edges.key, cost, fails)
        self.changed = np.zeros(len(self.quadrics), dtype=bool)
        self.touched = np.zeros(len(self.quadrics), dtype=bool)

    def _free_directions(self, edges: Edges) -> Booleans:
        """(e, 2) whether lines and the plane of symmetry allow a collapse from the first or second end of an edge."""
        n = len(self.quadrics)
        on_line = np.zeros(n, dtype=bool)
        on_line[edges.ends[edges.is_line]] = True
        fixed = np.zeros(n, dtype=bool)
        fixed[edges.ends[edges.is_odd]] = True
        may = ~fixed[edges.ends] & (~on_line[edges.ends] | edges.is_line[:, None])
        if self.mirror is not None:
            on_plane = (self.mirror == np.arange(n))[edges.ends]
            may &= ~on_plane | on_plane[:, ::-1]
        return may

    def _candidates(self, edges: Edges, directions: Booleans) -> _Candidates:
        """For each vertex that may move the cheapest neighbour to merge it into, the cheapest collapse first."""
        cost = np.where(directions & ~self.known.fails, self.known.cost, np.inf)
        direction, edge = np.divmod(np.flatnonzero(np.isfinite(cost.T.ravel())), len(cost))
        tail, head, cost = edges.ends[edge, direction], edges.ends[edge, 1 - direction], cost[edge, direction]
        order, _ = group_by_key(tail, len(self.quadrics))
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
        return _Candidates(tail[order], head[order], cost[order], rank, place[order])

    def _neutral(self, vertex: Integers) -> Integers:
        """Numbers that are equal for a vertex and its mirror image, to decide ties alike on both sides."""
        if self.mirror is None:
            return vertex
        other = self.mirror[vertex]
        return np.where(other >= 0, np.minimum(vertex, other), vertex)

    def _choose(self, among: _Candidates, edges: Edges, around: Lists) -> Integers:
        """Numbers of cheap collapses that do not touch each other. Impossible ones are marked."""
        tail, head, rank = among.tail, among.head, among.rank
        count = max(int(np.ceil(SHARE * len(tail))), 1)
        which, triangle = around.of(tail[:count])
        # The cheapest collapse is the last, so that assignments keep its rank.
        owner, vertex = np.repeat(which, 3)[::-1], self.triangles[triangle].ravel()[::-1]
        best = np.empty(len(self.quadrics), dtype=np.int64)
        taken = np.zeros(len(self.quadrics), dtype=bool)
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

    def _keep_regions(self, chosen: Integers, among: _Candidates, around: Lists) -> Integers:
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
        before, areas = self._normals(rows)
        after, now = self._normals(np.where(at_tail, head[which, None], rows))
        turned = (np.einsum("kpx,kpx->kp", before, after) < MIN_COSINE) & (areas > 0)
        bad = turned.any(axis=1) | (now[:, 0] <= 0)
        own = (self.corners[triangle] * at_tail).sum(axis=1)
        bad |= self._partners(tail, head, around, self.corners, self.wedge).find(which, self.wedge[own]) < 0
        bad |= self._folds(tail, head, which, triangle, after[:, 0], edges)
        if self.uv is not None:
            content = self.content[triangle]
            moved = self._move_content(tail, head, around, which, content, at_tail)
            bad |= _signed_areas(self.uv[content]) * _signed_areas(self.uv[moved]) < 0
        fits[which[bad]] = False
        return fits

    def _folds(
        self, tail: Integers, head: Integers, which: Integers, triangle: Integers, normals: Floats, edges: Edges
    ) -> Booleans:
        """(q,) whether collapses fold triangles onto a neighbour, clearly more than any at the same tail was before.

        Args:
            tail: (k,) the vertices that are merged.
            head: (k,) the vertices that they are merged into.
            which: (q,) the collapse of each triangle.
            triangle: (q,) the triangles at the tails that stay, each at one tail only.
            normals: (q, 3) their normals after the collapse, at rest.
            edges: the edges of the triangles.
        """
        beyond = edges.across[triangle]
        rows = self.triangles[beyond]
        at_tail = rows == tail[which, None, None]
        removed = at_tail.any(axis=2) & (rows == head[which, None, None]).any(axis=2) & (beyond >= 0)
        # The neighbour beyond a removed triangle is that across its side opposite the tail.
        beyond = np.where(removed, edges.across[beyond, (at_tail.argmax(axis=2) + 1) % 3], beyond)
        made = self.normals.copy()
        made[triangle] = normals
        opening = _openings(made, triangle, beyond)
        folds = opening < MIN_OPENING
        before = np.full(len(tail), FLAT_OPENING)
        np.minimum.at(before, which, _openings(self.normals, triangle, edges.across[triangle]))
        return folds & (opening < KEPT_OPENING * before[which])

    def _move_content(
        self, tail: Integers, head: Integers, around: Lists, which: Integers, content: Integers, at_tail: Booleans
    ) -> Integers:
        """The content (k, 3) of triangles after collapses `which`. Across a seam, they keep the content of the tail."""
        own = (content * at_tail).sum(axis=1)
        goal = self._partners(tail, head, around, self.content, self.content_wedge).find(which, self.content_wedge[own])
        return np.where(at_tail, np.where(goal < 0, own, goal)[:, None], content)

    def _partners(self, tail: Integers, head: Integers, around: Lists, corners: Integers, wedge: Integers) -> _Partners:
        """The corners of `head` in the triangles that a collapse removes, by the data of the corner of `tail` there."""
        which, triangle = around.of(tail)
        rows, corners = self.triangles[triangle], corners[triangle]
        at_head = rows == head[which, None]
        removed = at_head.any(axis=1)
        which, rows, corners, at_head = which[removed], rows[removed], corners[removed], at_head[removed]
        of_tail = (corners * (rows == tail[which, None])).sum(axis=1)
        return _Partners(which, wedge[of_tail], (corners * at_head).sum(axis=1), int(wedge.max(initial=0)) + 1)

    def _have_images(self, tail: Integers, head: Integers) -> Booleans:
        """Whether the mirror image of each collapse is among them; true for those without an image."""
        if self.mirror is None:
            return np.ones(len(tail), dtype=bool)
        goal = np.full(len(self.quadrics), -1)
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
        np.add.at(self.quadrics, head, self.quadrics[tail])
        np.add.at(self.area, head, self.area[tail])
        goal = np.arange(len(self.into))
        goal[tail] = head
        self.into = goal[self.into]
        if self.mirror is not None:  # images of vertices that are gone without theirs
            self._unpair(np.setdiff1d(self.mirror[tail], tail))
        heads = np.unique(head)
        self.own[heads] = self._products(heads, heads)
        self.changed[heads] = True
        self.touched[rows] = True
        if self.mirror is not None:
            for marks in (self.changed, self.touched):
                other = self.mirror[np.flatnonzero(marks)]
                marks[other[other >= 0]] = True
        whole = (self.triangles != np.roll(self.triangles, 1, axis=1)).all(axis=1)
        self.spare -= np.bincount(self.region[~whole], minlength=len(self.spare))
        self.triangles, self.alive, self.region = self.triangles[whole], self.alive[whole], self.region[whole]
        self.corners, self.content = self.corners[whole], self.content[whole]


@dataclass(frozen=True)
class _Candidates:
    """Collapses of vertices `tail` (k,) into `head` (k,), the cheapest first.

    Attributes:
        cost: (k,) their errors.
        rank: (k,) their order, the same for mirror images.
        place: (k,) twice the number of the edge, and one more if `tail` is its second end.
    """

    tail: Integers
    head: Integers
    cost: Floats
    rank: Integers
    place: Integers


@dataclass(frozen=True)
class _Costs:
    """The costs (e, 2) of collapses of the first and second end of edges, whose keys (e,) ascend.

    Attributes:
        fails: (e, 2) whether they were found to be impossible.
    """

    key: Integers
    cost: Floats
    fails: Booleans

    def find(self, key: Integers) -> Integers:
        """(k,) numbers of the edges with these keys, -1 for none."""
        if not len(self.key):
            return np.full(len(key), -1)
        at = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        return np.where(self.key[at] == key, at, -1)


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


def _openings(normals: Floats, triangle: Integers, beyond: Integers) -> Floats:
    """(q,) the smallest opening between triangles (q,) and their neighbours (q, 3), -1 for none, see `MIN_OPENING`."""
    opening = 1 + np.einsum("qx,qsx->qs", normals[triangle], normals[beyond])
    return np.asarray(np.where(beyond < 0, FLAT_OPENING, opening).min(axis=1))


def _signed_areas(triangles: Floats) -> Floats:
    """(k,) signed areas, twice, of triangles (k, 3, 2)."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
