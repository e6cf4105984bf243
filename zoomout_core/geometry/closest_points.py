# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points on triangle meshes in space; `embedded_surface.py` finds them in embeddings of any dimension.

The closest point is in the interior of a triangle, on an edge or at a corner. Inner products alone decide which
(Ericson, Real-Time Collision Detection, 5.1.5), so the same code works in any dimension.
"""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from zoomout_core.arrays import Floats, Indices, Integers, row_norms, take_rows
from zoomout_core.runtime.threads import threads

# Pairs of a point and a triangle processed together; bounds the memory.
BLOCK = 1 << 17
# Most triangles tested for a query, to bound the time: with more rivals it is as far off the surface as these are wide.
MAX_CANDIDATES = 256
# Minimum number of queries for which several threads are faster than one.
MANY_QUERIES = 10_000
# Guard against division by zero.
SMALLEST = np.finfo(np.float64).tiny


def closest_points(
    points: Floats, vertices: Floats, triangles: Integers, tolerance: float = 0.0
) -> tuple[Integers, Floats]:
    """Find the closest point of triangles (m, 3) on vertices (n, 3) for every query point (q, 3).

    Exact, except for points so far from the surface that more than 256 triangles are about equally close. A distance
    may exceed the minimum by the tolerance, in the unit of the vertices.

    Returns:
        (q,) triangle numbers and (q, 3) barycentric coordinates in them, non-negative, summing to one.
    """
    return SurfaceSearch(vertices, triangles).closest(points, tolerance)


class SurfaceSearch:
    """A mesh of triangles (m, 3) on vertices (n, 3), prepared once for searches of closest points in space."""

    def __init__(self, vertices: Floats, triangles: Integers) -> None:
        self.vertices, self.triangles = vertices, triangles
        self._used = np.flatnonzero(np.bincount(triangles.ravel(), minlength=len(vertices)))
        self._tree = search_tree(vertices[self._used])
        # Where each vertex's entries begin, and the triangles at the vertices, one vertex after the other.
        m = len(triangles)
        entries = np.ones(3 * m, dtype=np.int8), triangles.ravel(), 3 * np.arange(m + 1)
        table = scipy.sparse.csc_array(entries, shape=(len(vertices), m)).tocsr()
        self._at_vertex = table.indptr, table.indices

    def closest(self, points: Floats, tolerance: float = 0.0) -> tuple[Integers, Floats]:
        """Find the closest points for query points (q, 3), see `closest_points`."""
        found = _Closest(points, self.vertices, self.triangles)
        # The triangles at the nearest vertex are a good initial guess, which rules out most others.
        nearest = self._used[query_tree(self._tree, points, 1)[1]]
        for block in consecutive(np.diff(self._at_vertex[0])[nearest], BLOCK):
            first, triangle = self._at_vertex
            query, entry, _ = select_lists(first, nearest[block])
            candidate: Indices = take_rows(triangle, entry)
            found.improve(block[query], candidate)
        far = np.flatnonzero(found.distance > tolerance)
        if len(far):
            for group in self._groups:
                # A small triangle cannot be closer than the nearest vertex by more than the tolerance.
                if group.radius.max() > tolerance:
                    _search(found, far, group)
        return found.triangle, found.barycentric

    @cached_property
    def _groups(self) -> list[_Group]:
        """Group triangles by size, so that a few large ones do not widen the search among small ones."""
        a, b, c = (take_rows(self.vertices, corner) for corner in self.triangles.T)
        centre = (a + b + c) / 3
        radius = np.maximum.reduce([row_norms(corner - centre) for corner in (a, b, c)])
        size = np.clip(np.floor(np.log2(np.maximum(radius, 1e-300) / np.median(radius))), -2, 6)
        members = (np.flatnonzero(size == each) for each in np.unique(size))
        return [_Group(centre[chosen], radius[chosen], chosen) for chosen in members]


class _Group:
    """The triangles `members` (g,), of about one size.

    Their centres of gravity are (g, 3), and their corners at most a radius (g,) away from these.
    """

    def __init__(self, centre: Floats, radius: Floats, members: Integers) -> None:
        self.centre, self.radius, self.members = centre, radius, members

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        """Search tree of the centres, built on demand: that of the small triangles of large meshes is rarely needed."""
        return search_tree(self.centre)


def search_tree(points: Floats) -> scipy.spatial.cKDTree:
    """An unbalanced k-d tree of points (n, d), which is built in a third of the time and searched equally fast."""
    return scipy.spatial.cKDTree(points, balanced_tree=False, compact_nodes=False)


def query_tree(tree: scipy.spatial.cKDTree, points: Floats, count: int) -> tuple[Floats, Integers]:
    """Distances and numbers (q, count) of the points of a tree nearest to queries (q, d), in threads for many queries.

    They are (q,) for a count of one.
    """
    distance, number = tree.query(points, count, workers=threads() if len(points) > MANY_QUERIES else 1)
    return np.asarray(distance), np.asarray(number)


class _Closest:
    """The closest points found so far, as `closest_points` returns them, and their distances (q,)."""

    def __init__(self, points: Floats, vertices: Floats, triangles: Integers) -> None:
        self.points, self.vertices, self.triangles = points, vertices, triangles
        self.triangle = np.zeros(len(points), dtype=np.int64)
        self.barycentric = np.zeros((len(points), 3))
        self.distance = np.full(len(points), np.inf)

    def improve(self, queries: Integers, candidates: Integers) -> None:
        """Test pairs (p,) of a query and a triangle, sorted by query."""
        if len(queries) == 0:
            return
        # Coordinates first, (3, p): sums over a last axis of three take twice as long.
        a, ab, ac = take_rows(self.vertices, take_rows(self.triangles, candidates)).transpose(1, 2, 0).copy()
        ap = take_rows(self.points, queries).T - a
        ab -= a
        ac -= a
        weights = barycentric_of_closest(inner_products(ap, ab, ac, axis=0))
        off = ap - weights[:, 1] * ab - weights[:, 2] * ac
        distance = np.sqrt(off[0] ** 2 + off[1] ** 2 + off[2] ** 2)
        pick = first_min(distance, queries)
        pick = pick[distance[pick] < self.distance[queries[pick]]]
        chosen = queries[pick]
        self.triangle[chosen], self.barycentric[chosen] = candidates[pick], weights[pick]
        self.distance[chosen] = distance[pick]


def _search(found: _Closest, queries: Integers, group: _Group) -> None:
    """Search more and more triangles of about one size, until no other can be closer to some queries."""
    members, radius = group.members, group.radius
    reach = float(radius.max())
    count = min(8, len(members))
    while len(queries):
        unresolved = []
        for block in np.array_split(queries, 1 + len(queries) * count // BLOCK):
            parts = query_tree(group.tree, found.points[block], count)
            distance, near = (np.reshape(part, (len(block), count)) for part in parts)
            row, column = np.nonzero(distance - radius[near] < found.distance[block, None])
            found.improve(block[row], members[near[row, column]])
            unresolved.append(block[distance[:, -1] - reach < found.distance[block]])
        queries = np.concatenate(unresolved)
        if count == min(len(members), MAX_CANDIDATES):
            break
        count = min(4 * count, len(members), MAX_CANDIDATES)


def first_min(values: Floats, group: Integers) -> Integers:
    """The position of the minimum value (p,) of each group, given by ascending numbers (p,)."""
    begin = np.flatnonzero(np.diff(group, prepend=-1))
    least = np.repeat(np.minimum.reduceat(values, begin), np.diff(begin, append=len(group)))
    hit = np.flatnonzero(values <= least)
    return hit[np.flatnonzero(np.diff(group[hit], prepend=-1))]


def consecutive(sizes: Integers, max_size: int) -> list[Integers]:
    """Divide items of sizes (q,) into consecutive blocks.

    The sizes in a block, without its first, sum to less than `max_size`.
    """
    return np.split(np.arange(len(sizes)), np.flatnonzero(np.diff(np.cumsum(sizes) // max_size)) + 1)


def select_lists(first: Indices, chosen: Integers) -> tuple[Integers, Integers, Integers]:
    """Select the lists of chosen owners (c,) among entries in which those of owner i begin at `first[i]`.

    Returns:
        (p,) the position in `chosen` of each entry, (p,) its number, and (c,) where each list begins among them.
    """
    size = np.diff(first)[chosen]
    begin = np.cumsum(size) - size
    return (
        np.repeat(np.arange(len(chosen)), size),
        np.arange(size.sum()) - np.repeat(begin - first[chosen], size),
        begin,
    )


def closest_on_triangles(points: Floats, a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    """The points of triangles abc that are closest to points; all are (..., 3), of a common shape.

    Returns:
        (..., 3) barycentric coordinates, and (..., 3) vectors from there to the points.
    """
    ap, ab, ac = points - a, b - a, c - a
    weights = barycentric_of_closest(inner_products(ap, ab, ac, axis=-1))
    return weights, ap - weights[..., 1:2] * ab - weights[..., 2:] * ac


def inner_products(ap: Floats, ab: Floats, ac: Floats, axis: Literal[0, -1]) -> tuple[Floats, ...]:
    """Five inner products (...) for `barycentric_of_closest`, over the first axis, which is faster, or the last."""
    over = "x...,x...->..." if axis == 0 else "...x,...x->..."
    pairs = (ap, ab), (ap, ac), (ab, ab), (ab, ac), (ac, ac)
    return tuple(np.einsum(over, u, v) for u, v in pairs)


def barycentric_of_closest(dots: tuple[Floats, ...]) -> Floats:
    """(..., 3) barycentric coordinates, non-negative, of the point of a triangle abc that is closest to p.

    The inner products are ap.ab, ap.ac, ab.ab, ab.ac, ac.ac. A degenerate triangle gives a point of it.
    """
    ap_ab, ap_ac, ab_ab, ab_ac, ac_ac = dots
    bc_bc = ab_ab - 2 * ab_ac + ac_ac
    bp_bc = ap_ac - ab_ac - ap_ab + ab_ab

    def clip_to(along: Floats, length: Floats) -> Floats:
        return np.minimum(np.maximum(along / np.maximum(length, SMALLEST), 0), 1)

    # The closest point of each side, and its squared distance minus |p - a|^2.
    on_ab, on_ac, on_bc = clip_to(ap_ab, ab_ab), clip_to(ap_ac, ac_ac), clip_to(bp_bc, bc_bc)
    to_ab = on_ab * (on_ab * ab_ab - 2 * ap_ab)
    to_ac = on_ac * (on_ac * ac_ac - 2 * ap_ac)
    to_bc = on_bc * (on_bc * bc_bc - 2 * bp_bc) + ab_ab - 2 * ap_ab
    is_bc, is_ab = to_bc < np.minimum(to_ab, to_ac), to_ab <= to_ac
    v = np.where(is_bc, 1 - on_bc, on_ab * is_ab)
    w = np.where(is_bc, on_bc, on_ac * ~is_ab)
    # Over the interior, the projection is closer than all sides.
    whole: Floats = ab_ab * ac_ac - ab_ac * ab_ac
    of_b: Floats = ac_ac * ap_ab - ab_ac * ap_ac
    of_c: Floats = ab_ab * ap_ac - ab_ac * ap_ab
    inside = (of_b > 0) & (of_c > 0) & (of_b + of_c < whole)
    np.divide(of_b, whole, out=v, where=inside)
    np.divide(of_c, whole, out=w, where=inside)
    return np.stack([np.maximum(1 - v - w, 0), v, w], axis=-1)
