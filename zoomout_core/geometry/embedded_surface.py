# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points on embedded surfaces, of any dimension, near a known vertex: the precise map."""

from __future__ import annotations

import numpy as np
import scipy

from zoomout_core.arrays import AnyFloats, Floats, Integers, take_rows
from zoomout_core.geometry.closest_points import BLOCK, barycentric_of_closest, consecutive, first_min, select_lists

# Number of triangles at a vertex above which it is the hub of a fan, such as the tip of a cone. What surrounds it
# surrounds all vertices of the fan, so that lists of surroundings through hubs would grow by the square of its size.
HUB = 256
# In fewer dimensions, single precision cannot distinguish neighbours.
SINGLE_PRECISION_DIMENSION = 16


class Neighbourhoods:
    """The triangles (m, 3) within some edges, from 0, of each of n vertices of a mesh, prepared for many projections.

    Hubs (`HUB`) are surrounded like other vertices, but not passed through.

    Attributes:
        triangles: (m, 3) vertex numbers.
        first_triangle: (n + 1,) where each vertex's entries in `triangle` begin.
        triangle: numbers of the triangles near each vertex, one vertex after the other.
        first_vertex: (n + 1,) where each vertex's entries in `vertex` begin.
        vertex: numbers of those triangles' corners, each once, one vertex after the other.
        corners: (len(triangle), 3) positions of a triangle's corners among its vertex's entries in `vertex`.
    """

    def __init__(self, triangles: Integers, n: int, edges: int = 1) -> None:
        m = len(triangles)
        ones, number = np.ones(3 * m, bool), np.repeat(np.arange(m), 3)
        at_vertex = scipy.sparse.coo_array((ones, (triangles.ravel(), number)), shape=(n, m)).tocsr()
        passed = at_vertex
        if (is_hub := np.diff(at_vertex.indptr) > HUB).any():
            passed = scipy.sparse.coo_array(
                (~is_hub[triangles].ravel(), (triangles.ravel(), number)), shape=(n, m)
            ).tocsr()
            passed.eliminate_zeros()
        near = at_vertex
        for _ in range(edges):
            further = near @ passed.T @ passed
            near = (further if passed is at_vertex else near + further).tocsr()
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
    """Precise map: find the point of an embedded surface (n, k) that is closest to each query (q, k).

    Only the neighbourhood of the nearest vertex (q,) is searched, in blocks of bounded memory: the local variant of
    Ezuz and Ben-Chen, Deblurring and denoising of maps between shapes (2017). Uses single precision for many
    dimensions.

    Returns:
        (q,) triangle numbers and (q, 3) barycentric coordinates.
    """
    return EmbeddedSurface(embedding, neighbourhoods).closest(points, nearest)


class EmbeddedSurface:
    """An embedded surface (n, k), prepared once to project many points onto it, see `project_to_embedding`.

    Every vertex must be used by the triangles of the neighbourhoods.
    """

    def __init__(self, embedding: Floats, neighbourhoods: Neighbourhoods) -> None:
        dtype: type = np.float32 if embedding.shape[1] >= SINGLE_PRECISION_DIMENSION else np.float64
        self._embedding: AnyFloats = embedding.astype(dtype)
        self._neighbourhoods = neighbourhoods
        a, b, c = (take_rows(self._embedding, corner) for corner in neighbourhoods.triangles.T)
        ab, ac = b - a, c - a
        pairs = (ab, ab), (ab, ac), (ac, ac), (a, ab), (a, ac), (a, a)
        self._products = [np.einsum("mk,mk->m", x, y).astype(np.float64) for x, y in pairs]

    def closest(self, points: Floats, nearest: Integers) -> tuple[Integers, Floats]:
        """(q,) triangle numbers and (q, 3) barycentric coordinates of the points closest to points (q, k).

        The search is limited to the neighbourhood of the vertex (q,) nearest to each.
        """
        embedding, neighbourhoods = self._embedding, self._neighbourhoods
        points = points.astype(embedding.dtype)
        ab_ab, ab_ac, ac_ac, a_ab, a_ac, a_a = self._products
        triangle = np.zeros(len(points), dtype=np.int64)
        barycentric = np.zeros((len(points), 3))
        # Queries with the same nearest vertex share its candidates' rows in the processor's cache.
        order = np.argsort(nearest, kind="stable")
        pairs_each = np.diff(neighbourhoods.first_vertex)[nearest[order]].astype(np.int64)
        for block in map(order.__getitem__, consecutive(pairs_each * max(8, embedding.shape[1]), BLOCK * 2)):
            # Inner products of each query with each nearby vertex, computed once per pair.
            query, entry, first = select_lists(neighbourhoods.first_vertex, nearest[block])
            beside = take_rows(points, block[query]), take_rows(embedding, take_rows(neighbourhoods.vertex, entry))
            all_products = np.einsum("pk,pk->p", *beside)
            query, entry, _ = select_lists(neighbourhoods.first_triangle, nearest[block])
            candidate, corners = take_rows(neighbourhoods.triangle, entry), take_rows(neighbourhoods.corners, entry)
            product = all_products[first[query, None] + corners].astype(np.float64)
            ap_ab = product[:, 1] - product[:, 0] - a_ab[candidate]
            ap_ac = product[:, 2] - product[:, 0] - a_ac[candidate]
            dots = ap_ab, ap_ac, ab_ab[candidate], ab_ac[candidate], ac_ac[candidate]
            weights = barycentric_of_closest(dots)
            v, w = weights[:, 1], weights[:, 2]
            # |p - foot|^2 minus |p|^2, which is enough to compare candidates of a query
            offset = a_a[candidate] - 2 * product[:, 0]
            distance = offset - 2 * (v * ap_ab + w * ap_ac) + v * v * dots[2] + 2 * v * w * dots[3] + w * w * dots[4]
            hit = first_min(distance, query)
            triangle[block] = candidate[hit]
            barycentric[block] = weights[hit]
        return triangle, barycentric
