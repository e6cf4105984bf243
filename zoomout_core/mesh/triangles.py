# SPDX-License-Identifier: GPL-3.0-or-later
"""Areas, normals and edges of triangles on points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from zoomout_core.arrays import (
    Booleans,
    Floats,
    Indices,
    Integers,
    all_in_row,
    any_in_row,
    row_norms,
    segment_sum,
    take_rows,
)

# Triangles whose corners are read at once, which fit into the processor's cache.
TRIANGLES = 1 << 14


def triangle_areas(vertices: Floats, triangles: Integers) -> Floats:
    """(m,) areas of the triangles (m, 3) on the points (n, 3)."""
    return 0.5 * row_norms(area_normals(vertices, triangles))


def vertex_areas(vertices: Floats, triangles: Integers) -> Floats:
    """(n,) a third of the area of the triangles (m, 3) around each of the points (n, 3)."""
    return segment_sum(np.repeat(triangle_areas(vertices, triangles) / 3, 3), triangles.ravel(), len(vertices))


def triangle_normals(vertices: Floats, triangles: Integers) -> Floats:
    """(m, 3) unit normals of the triangles (m, 3) on the points (n, 3); zero for a degenerate one."""
    return unit_vectors(area_normals(vertices, triangles))


def vertex_normals(vertices: Floats, triangles: Integers) -> Floats:
    """(n, 3) unit normals of the vertices, averaged over triangles by area; zero without triangles."""
    corner, n = triangles.ravel(), len(vertices)
    sums = [segment_sum(np.repeat(along, 3), corner, n) for along in area_normals(vertices, triangles).T]
    return unit_vectors(np.stack(sums, axis=1))


def unit_vectors(vectors: Floats) -> Floats:
    """Vectors (m, 3) scaled to unit length; zero vectors stay."""
    length = row_norms(vectors)[:, None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def have_three_corners(triangles: Integers) -> Booleans:
    """(m,) which triangles (m, 3) have three different corners."""
    a, b, c = triangles.T
    return np.asarray((a != b) & (b != c) & (c != a))


def unique_edges(triangles: Integers) -> tuple[Integers, Integers]:
    """The undirected edges of triangles (m, 3).

    Returns:
        (e, 2) vertex numbers, the smaller first, and (m, 3) the edge from each corner to the next.
    """
    side, first = sides_by_edge(triangles)
    edge_of = np.empty(triangles.size, dtype=np.int64)
    edge_of[side] = np.repeat(np.arange(len(first) - 1), np.diff(first))
    low, high = _ends(triangles)
    chosen = side[first[:-1]]
    return np.stack([low[chosen], high[chosen]], axis=1), edge_of.reshape(-1, 3)


def border_edges(triangles: Integers) -> Integers:
    """(b, 2) the undirected edges of only one triangle (m, 3)."""
    edges, edge_of = unique_edges(triangles)
    return np.asarray(edges[np.bincount(edge_of.ravel(), minlength=len(edges)) == 1])


def _ends(triangles: Integers) -> tuple[Integers, Integers]:
    """(3m,) the smaller and the larger vertex of each side of triangles (m, 3), from a corner to the next."""
    following = np.roll(triangles, -1, axis=1)
    return np.minimum(triangles, following).ravel(), np.maximum(triangles, following).ravel()


class Sides(NamedTuple):
    """The sides of triangles, one undirected edge after the other.

    Attributes:
        side: (3m,) numbers of the sides; 3 t is the side from the first corner of triangle t to the second.
        first: (e + 1,) where the sides of each edge begin among these.
    """

    side: Indices
    first: Integers


def sides_by_edge(triangles: Integers) -> Sides:
    """Group the sides of triangles (m, 3) by the vertices that they connect.

    They are counted into the rows of a sparse matrix, which takes a third of the time of sorting them.
    """
    low, high = _ends(triangles)
    n = int(high.max(initial=-1)) + 1
    one_each = np.ones(len(low), dtype=np.int8), low, np.arange(len(low) + 1)
    by_low = scipy.sparse.csc_array(one_each, shape=(n, len(low))).tocsr()
    table = scipy.sparse.csr_array((by_low.indices, high[by_low.indices], by_low.indptr), shape=(n, n))
    table.sort_indices()
    side = table.data
    begins = np.ones(len(side), dtype=bool)
    begins[1:] = (np.diff(table.indices) != 0) | (np.diff(low[side]) != 0)
    return Sides(side, np.append(np.flatnonzero(begins), len(side)))


def edge_graph(vertices: Floats, triangles: Integers) -> scipy.sparse.csr_array:
    """(n, n) graph of a triangle mesh's edges, weighted by their lengths; symmetric."""
    edges, _ = unique_edges(triangles)
    length = edge_lengths(vertices, edges)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    return scipy.sparse.csr_array(
        (np.concatenate([length, length]), (rows, columns)), shape=(len(vertices), len(vertices))
    )


def edge_lengths(points: Floats, edges: Integers) -> Floats:
    """(...) lengths of edges (..., 2) between points (n, d)."""
    return row_norms(take_rows(points, edges[..., 0]) - take_rows(points, edges[..., 1]))


def components(pairs: Integers, n: int) -> Indices:
    """(n,) the number of each vertex's connected component, from connected pairs (e, 2)."""
    # Other types of values and numbers would be converted.
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), np.ascontiguousarray(pairs.T, dtype=np.int32)), shape=(n, n))
    graph.has_canonical_format = True  # or pairs would be sorted and repeated ones added up, in as much time again
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1])


def area_normals(vertices: Floats, triangles: Integers) -> Floats:
    """(m, 3) normals of the triangles (m, 3) on the points (n, 3), twice as long as their areas."""
    normals = np.empty((len(triangles), 3), dtype=vertices.dtype)
    for first in range(0, len(triangles), TRIANGLES):
        block = slice(first, first + TRIANGLES)
        # Coordinates first: products of one with another take half the time of whole vectors.
        a, ab, ac = (take_rows(vertices, corner).T.copy() for corner in triangles[block].T)
        ab -= a
        ac -= a
        for i in range(3):
            np.subtract(ab[i - 2] * ac[i - 1], ab[i - 1] * ac[i - 2], out=normals[block, i])
    return normals


def cross(u: Floats, v: Floats) -> Floats:
    """(..., 3) cross products of vectors (..., 3), several times as fast as numpy's."""
    return np.stack([u[..., i - 2] * v[..., i - 1] - u[..., i - 1] * v[..., i - 2] for i in range(3)], axis=-1)


def signed_areas(corners: Floats) -> Floats:
    """(m,) twice the areas of triangles in the plane with corners (m, 3, 2); negative for clockwise ones."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def at_any(chosen: Booleans, triangles: Integers) -> Booleans:
    """A mask (m,) of the triangles (m, 3), or edges (m, 2), with a corner among some vertices (n,)."""
    return any_in_row(chosen[triangles])


def at_all(chosen: Booleans, triangles: Integers) -> Booleans:
    """A mask (m,) of the triangles (m, 3), or edges (m, 2), with all corners among some vertices (n,)."""
    return all_in_row(chosen[triangles])


def widen(chosen: Booleans, triangles: Integers) -> Booleans:
    """A mask (n,) of some vertices (n,), and of those that share a triangle (m, 3) with them."""
    wider = chosen.copy()
    wider[triangles[at_any(chosen, triangles)]] = True
    return wider
