"""Closest points on triangle meshes: in space, and in the high-dimensional embeddings of spectral bases.

A point is closest to the interior of a triangle, to an edge or to a corner; which one follows from inner
products alone (Ericson, Real-Time Collision Detection, 5.1.5), so the same code serves any dimension.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from zoomout_core.surface import Floats, Integers

# Pairs of a point and a triangle that are looked at together: bounds the memory.
BLOCK = 1 << 19
# A query that still has rivals after this many triangles is as far off the surface as these are wide.
MOST_CANDIDATES = 256
FIRST_GUESSES = 6
# In fewer dimensions than this, single precision cannot tell neighbours apart.
SINGLE_PRECISION_DIMENSION = 16


def closest_points(
    points: Floats, vertices: Floats, triangles: Integers, tolerance: float = 0.0
) -> tuple[Integers, Floats]:
    """The closest point of a triangle mesh in space, for every query point.

    Exact, but for points so far from the surface that more than 256 triangles are about as close.

    Args:
        points: (q, 3) queries.
        vertices: (n, 3) positions, in the same unit.
        triangles: (m, 3) vertex numbers.
        tolerance: a point of the mesh that is as near as this is near enough, in the same unit.

    Returns:
        (q,) triangle numbers and (q, 3) barycentric coordinates in them, non-negative, summing to one.
    """
    corners = vertices[triangles]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    found = _Closest(points, corners)
    # A triangle that is near is a good first guess, and rules out most others.
    tree, count = cKDTree(centre), min(FIRST_GUESSES, len(triangles))
    for block in np.array_split(np.arange(len(points)), 1 + len(points) * count // BLOCK):
        near = np.reshape(tree.query(points[block], count)[1], (len(block), count))
        found.improve(np.repeat(block, count), near.ravel())
    far = np.flatnonzero(found.distance > tolerance)
    # Triangles by size, so that a few large ones do not widen the search among the small ones.
    size = np.floor(np.log2(np.maximum(radius, 1e-300) / np.median(radius)))
    for group in np.unique(np.clip(size, -2, 6)):
        members = np.flatnonzero(np.clip(size, -2, 6) == group)
        _search(found, far, cKDTree(centre[members]), members, radius[members])
    return found.triangle, found.barycentric


class _Closest:
    """The closest points found so far, as `closest_points` returns them, and their distances (q,)."""

    def __init__(self, points: Floats, corners: Floats) -> None:
        self.points, self.corners = points, corners
        self.triangle = np.zeros(len(points), dtype=np.int64)
        self.barycentric = np.zeros((len(points), 3))
        self.distance = np.full(len(points), np.inf)

    def improve(self, queries: Integers, candidates: Integers) -> None:
        """Look at pairs (p,) of a query, in ascending order, and a triangle."""
        if len(queries) == 0:
            return
        a, b, c = (self.corners[candidates, i] for i in range(3))
        weights = barycentric_of_closest(_dots(self.points[queries] - a, b - a, c - a))
        foot = np.einsum("pi,pix->px", weights, self.corners[candidates])
        distance = np.linalg.norm(foot - self.points[queries], axis=1)
        pick = _first_least(distance, queries)
        pick = pick[distance[pick] < self.distance[queries[pick]]]
        chosen = queries[pick]
        self.triangle[chosen], self.barycentric[chosen] = candidates[pick], weights[pick]
        self.distance[chosen] = distance[pick]


def _search(found: _Closest, queries: Integers, tree: cKDTree, members: Integers, radius: Floats) -> None:
    """Look among triangles of about one size, more and more of them, until none can be closer to some queries."""
    reach = float(radius.max())
    count = min(4, len(members))
    while len(queries):
        unresolved = []
        for block in np.array_split(queries, 1 + len(queries) * count // BLOCK):
            distance, near = (np.reshape(part, (len(block), count)) for part in tree.query(found.points[block], count))
            row, column = np.nonzero(distance - radius[near] < found.distance[block, None])
            found.improve(block[row], members[near[row, column]])
            unresolved.append(block[distance[:, -1] - reach < found.distance[block]])
        queries = np.concatenate(unresolved)
        if count == min(len(members), MOST_CANDIDATES):
            break
        count = min(4 * count, len(members), MOST_CANDIDATES)


def _first_least(values: Floats, group: Integers) -> Integers:
    """The position of the least value (p,) of each group, given by ascending numbers (p,)."""
    begin = np.flatnonzero(np.diff(group, prepend=-1))
    least = np.repeat(np.minimum.reduceat(values, begin), np.diff(begin, append=len(group)))
    hit = np.flatnonzero(values <= least)
    return hit[np.flatnonzero(np.diff(group[hit], prepend=-1))]


class Neighbourhoods:
    """The triangles within two edges of each vertex of a mesh, prepared for many projections.

    Attributes:
        triangles: (m, 3) vertex numbers.
        first_triangle: (n + 1,) where each vertex's entries in `triangle` begin.
        triangle: numbers of the triangles near each vertex, one vertex after the other.
        first_vertex: (n + 1,) where each vertex's entries in `vertex` begin.
        vertex: numbers of those triangles' corners, each once, one vertex after the other.
        corners: (len(triangle), 3) where among its vertex's entries in `vertex` a triangle's corners stand.
    """

    def __init__(self, triangles: Integers, n: int) -> None:
        m = len(triangles)
        ones, number = np.ones(3 * m, bool), np.repeat(np.arange(m), 3)
        at_vertex = coo_array((ones, (triangles.ravel(), number)), shape=(n, m)).tocsr()
        near = ((at_vertex @ at_vertex.T) @ at_vertex).tocsr()
        around = (near @ at_vertex.T).tocsr()
        around.sort_indices()
        self.triangles = triangles
        self.first_triangle, self.triangle = near.indptr, near.indices
        self.first_vertex, self.vertex = around.indptr, around.indices
        owner, of_triangle = (np.repeat(np.arange(n), np.diff(first)) for first in (around.indptr, near.indptr))
        found = np.searchsorted(owner * n + self.vertex, of_triangle[:, None] * n + triangles[self.triangle])
        self.corners = found - self.first_vertex[of_triangle, None]


def project_to_embedding(
    points: Floats, embedding: Floats, neighbourhoods: Neighbourhoods, nearest: Integers
) -> tuple[Integers, Floats]:
    """Precise map: the closest point on an embedded surface, sought around the nearest vertex.

    Looks at the triangles within two edges of the nearest vertex, as Ezuz and Ben-Chen (Deblurring and
    denoising of maps between shapes, 2017) do in their local variant; memory stays bounded. Where there are many
    dimensions, it reckons in single precision.

    Args:
        points: (q, k) queries in the embedding.
        embedding: (n, k) the surface's vertices in the embedding.
        neighbourhoods: of the surface's triangles; every vertex is used.
        nearest: (q,) the vertex of the embedding nearest to each query.

    Returns:
        (q,) triangle numbers and (q, 3) barycentric coordinates.
    """
    dtype: type = np.float32 if embedding.shape[1] >= SINGLE_PRECISION_DIMENSION else np.float64
    points, embedding = points.astype(dtype), embedding.astype(dtype)
    triangles = neighbourhoods.triangles
    a, b, c = (embedding[corner] for corner in triangles.T)
    ab, ac = b - a, c - a
    pairs = (ab, ab), (ab, ac), (ac, ac), (a, ab), (a, ac), (a, a)
    ab_ab, ab_ac, ac_ac, a_ab, a_ac, a_a = (np.einsum("mk,mk->m", x, y).astype(np.float64) for x, y in pairs)
    triangle = np.zeros(len(points), dtype=np.int64)
    barycentric = np.zeros((len(points), 3))
    # Queries that share a nearest vertex share its candidates' rows in the cache.
    order = np.argsort(nearest, kind="stable")
    pairs_each = max(1, len(neighbourhoods.vertex) // max(1, len(embedding)))
    per_block = max(1, BLOCK * 2 // (pairs_each * max(8, embedding.shape[1])))
    for block in np.array_split(order, max(1, len(order) // per_block)):
        # Inner products of each query with each vertex near it, once a pair.
        query, pair_vertex, first = _lists(neighbourhoods.first_vertex, neighbourhoods.vertex, nearest[block])
        all_products = np.einsum("pk,pk->p", points[block][query], embedding[pair_vertex])
        query, candidate, _ = _lists(neighbourhoods.first_triangle, neighbourhoods.triangle, nearest[block])
        _, corners, _ = _lists(neighbourhoods.first_triangle, neighbourhoods.corners, nearest[block])
        product = all_products[first[query, None] + corners].astype(np.float64)
        ap_ab = product[:, 1] - product[:, 0] - a_ab[candidate]
        ap_ac = product[:, 2] - product[:, 0] - a_ac[candidate]
        dots = ap_ab, ap_ac, ab_ab[candidate], ab_ac[candidate], ac_ac[candidate]
        weights = barycentric_of_closest(dots)
        v, w = weights[:, 1], weights[:, 2]
        # |p - foot|^2 less |p - a|^2, and that less |p|^2, so that candidates of a query compare
        offset = a_a[candidate] - 2 * product[:, 0]
        distance = offset - 2 * (v * ap_ab + w * ap_ac) + v * v * dots[2] + 2 * v * w * dots[3] + w * w * dots[4]
        hit = _first_least(distance, query)
        triangle[block] = candidate[hit]
        barycentric[block] = weights[hit]
    return triangle, barycentric


def _lists(first: Integers, entries: Integers, chosen: Integers) -> tuple[Integers, Integers, Integers]:
    """The lists of some owners, of those that are kept one after the other, again one after the other.

    Args:
        first: (n + 1,) where each owner's list begins.
        entries: (e, ...) all lists.
        chosen: (c,) owners.

    Returns:
        (p,) the position in `chosen` of each entry, (p, ...) the entries, and (c,) where each list begins among them.
    """
    size = np.diff(first)[chosen]
    begin = np.cumsum(size) - size
    return (
        np.repeat(np.arange(len(chosen)), size),
        entries[np.arange(size.sum()) - np.repeat(begin - first[chosen], size)],
        begin,
    )


def _dots(ap: Floats, ab: Floats, ac: Floats) -> tuple[Floats, ...]:
    return tuple(np.einsum("...x,...x->...", x, y) for x, y in ((ap, ab), (ap, ac), (ab, ab), (ab, ac), (ac, ac)))


def barycentric_of_closest(dots: tuple[Floats, ...]) -> Floats:
    """Barycentric coordinates of the point of a triangle abc that is closest to p.

    Args:
        dots: the inner products ap.ab, ap.ac, ab.ab, ab.ac, ac.ac, of any common shape.

    Returns:
        (..., 3) weights of a, b, c, non-negative, summing to one; a degenerate triangle gives a point of it.
    """
    ap_ab, ap_ac, ab_ab, ab_ac, ac_ac = dots
    bp_ab, bp_ac = ap_ab - ab_ab, ap_ac - ab_ac
    cp_ab, cp_ac = ap_ab - ab_ac, ap_ac - ac_ac
    va = bp_ab * cp_ac - cp_ab * bp_ac
    vb = cp_ab * ap_ac - ap_ab * cp_ac
    vc = ap_ab * bp_ac - bp_ab * ap_ac
    along_bc = bp_ac - bp_ab

    def ratio(numerator: Floats, denominator: Floats) -> Floats:
        return np.divide(numerator, denominator, out=np.zeros_like(numerator), where=denominator > 0)

    zero, one = np.zeros_like(ap_ab), np.ones_like(ap_ab)
    on_ab, on_ac = ratio(ap_ab, ab_ab), ratio(ap_ac, ac_ac)
    on_bc = ratio(along_bc, along_bc + cp_ab - cp_ac)
    total = va + vb + vc
    regions = [
        (ap_ab <= 0) & (ap_ac <= 0),
        (bp_ab >= 0) & (bp_ac <= bp_ab),
        (cp_ac >= 0) & (cp_ab <= cp_ac),
        (vc <= 0) & (ap_ab >= 0) & (bp_ab <= 0),
        (vb <= 0) & (ap_ac >= 0) & (cp_ac <= 0),
        (va <= 0) & (along_bc >= 0) & (cp_ab - cp_ac >= 0),
    ]
    v = np.select(regions, [zero, one, zero, on_ab, zero, 1 - on_bc], ratio(vb, total))
    w = np.select(regions, [zero, zero, one, zero, on_ac, on_bc], ratio(vc, total))
    return np.stack([np.maximum(1 - v - w, 0), v, w], axis=-1)
