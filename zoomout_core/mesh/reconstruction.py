# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruct a triangle mesh from a point cloud, by Delaunay triangulations in the points' tangent planes.

Each point is joined to its natural neighbours in its tangent plane (Gopi, Krishnan and Silva, Surface reconstruction
based on lower dimensional localized Delaunay triangulation, 2000). From these triangles an oriented manifold is
selected, beginning with those that all three corners agree on. Points across a gap are not natural neighbours if the
gap is wider than their spacing. Normals that are not given come from the best fitting planes, oriented consistently
along the tree of the smallest turns (Hoppe et al., Surface reconstruction from unorganized points, 1992).
"""

from __future__ import annotations

import numpy as np
import scipy

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import area_normals, components, triangle_areas, unique_edges, unit_vectors

# Points processed together; bounds the memory.
BLOCK = 1 << 15
# Rank of the neighbour whose distance is the spacing of the points: vertices of a mesh have about this many.
SPACING = 6
# A triangle of less area, relative to the square of its longest edge, counts as three collinear points.
ON_A_LINE = 1e-6
# Number of nearest points in space that may be neighbours on the surface; more take longer to triangulate.
NEIGHBOURS = 24
# Number of nearest points in space for fitting tangent planes; more would smooth bends away.
PLANE_NEIGHBOURS = 12
# Cosine of the angle between given normals below which two points are not neighbours, but on two sides of a sheet.
MIN_NORMAL_COSINE = 0.3
# Longest edge of a triangle, in spacings at each of its corners; longer ones bridge gaps.
MAX_EDGE = 8.0
# Parts of fewer triangles are discarded as outliers.
MIN_PART_TRIANGLES = 20


def triangulate_points(points: Floats, normals: Floats | None = None) -> Integers:
    """(m, 3) triangles of an oriented manifold through points (n, 3), with outward unit normals (n, 3) if known.

    A few points of a noisy cloud are in no triangle, and neither are duplicates of a point.
    """
    _, first = np.unique(points, axis=0, return_index=True)
    first.sort()
    if len(first) < 4:
        return np.zeros((0, 3), dtype=np.int64)
    points = points[first]
    count = min(NEIGHBOURS, len(points) - 1)
    distance, near = (np.asarray(array) for array in scipy.spatial.cKDTree(points).query(points, count + 1))
    facing = _plane_normals(points, near) if normals is None else normals[first]
    either = normals is None
    blocks = np.array_split(np.arange(len(points)), 1 + len(points) // BLOCK)
    stars = np.concatenate([_stars(block, near[block, 1:], points, facing, either) for block in blocks])
    triangles, agreed = np.unique(np.sort(stars, axis=1), axis=0, return_counts=True)
    longest = np.linalg.norm(points[triangles] - points[np.roll(triangles, -1, axis=1)], axis=2).max(axis=1)
    spanned = longest <= MAX_EDGE * distance[:, min(SPACING, count)][triangles].min(axis=1)
    spanned &= triangle_areas(points, triangles) > ON_A_LINE * longest**2
    triangles, agreed, longest = triangles[spanned], agreed[spanned], longest[spanned]
    if normals is None:
        # Triangles of a single star cross gaps: using them raises the error of the spectra of seven clouds by a sixth.
        facing = facing * _senses(facing, triangles[agreed > 1])[:, None]
    # First the triangles that more corners agree on, then those with shorter edges.
    triangles = _manifold(triangles, np.lexsort((longest, -agreed)), points, facing)
    edges, _ = unique_edges(triangles)
    part = components(edges, len(points))[triangles[:, 0]]
    return first[triangles[np.bincount(part)[part] >= MIN_PART_TRIANGLES]]


def _plane_normals(points: Floats, near: Integers) -> Floats:
    """(n, 3) unit normals, of either sign, of the planes that best fit each point and its neighbours (n, c)."""
    around = points[near[:, : PLANE_NEIGHBOURS + 1]]
    around = around - around.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nci,ncj->nij", around, around))
    return np.asarray(vectors[:, :, 0])


def _stars(centre: Integers, near: Integers, points: Floats, normals: Floats, either: bool) -> Integers:
    """(s, 3) Delaunay triangles around centres (b,) and their neighbours (b, c) in tangent planes.

    After inversion in the unit circle around a point, its Delaunay neighbours are the corners of the convex hull.
    Normals (n, 3) of either sign cannot rule out neighbours.
    """
    offset, normal = points[near] - points[centre, None], normals[centre]
    length = np.linalg.norm(offset, axis=2)
    joined = either | (np.einsum("bcx,bx->bc", normals[near], normal) >= MIN_NORMAL_COSINE)
    u = unit_vectors(np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)]))
    x, y = (np.einsum("bcx,bx->bc", offset, axis) for axis in (u, np.cross(normal, u)))
    angle = np.where(joined, np.arctan2(y, x), np.inf)
    order = np.argsort(angle, axis=1, kind="stable")
    near, length, angle, joined = (np.take_along_axis(array, order, axis=1) for array in (near, length, angle, joined))
    # Rotate into the plane, keeping the distance: on a curved surface a projection would shorten it.
    inverse = 1 / length
    x, y = inverse * np.cos(np.where(joined, angle, 0)), inverse * np.sin(np.where(joined, angle, 0))
    corner, following = _hull_corners(joined, x, y)
    row, column = np.nonzero(corner)
    after = following[row, column]
    ahead = x[row, column] * y[row, after] - y[row, column] * x[row, after] > 0  # less than half a turn ahead
    row, column, after = row[ahead], column[ahead], after[ahead]
    return np.column_stack([centre[row], near[row, column], near[row, after]])


def _hull_corners(joined: Booleans, x: Floats, y: Floats) -> tuple[Booleans, Integers]:
    """Corners of the convex hulls of rows of points (b, c), where `joined`, and the origin; they are sorted by angle.

    Returns:
        (b, c) which points are corners, and for each point the column of the next corner.
    """
    corner, following = joined.copy(), np.zeros(joined.shape, dtype=np.int64)
    rows = np.arange(len(joined))
    while len(rows):
        after, before = _next(corner[rows]), _next(corner[rows, ::-1])[:, ::-1]
        before = corner.shape[1] - 1 - before
        following[rows] = after
        X, Y = x[rows], y[rows]
        (x0, y0), (x1, y1) = (
            (np.take_along_axis(X, column, axis=1), np.take_along_axis(Y, column, axis=1)) for column in (before, after)
        )
        # Inside the triangle of the origin and both neighbours; never if these are half a turn apart.
        inside = (X - x0) * (y1 - Y) - (Y - y0) * (x1 - X) <= 0
        inside &= corner[rows] & (x0 * Y - y0 * X > 0) & (X * y1 - Y * x1 > 0)
        corner[rows] &= ~inside
        rows = rows[inside.any(axis=1)]
    return corner, following


def _next(chosen: Booleans) -> Integers:
    """(b, c) for each column the next chosen one in its row, cyclically."""
    columns = chosen.shape[1]
    number = np.where(chosen, np.arange(columns), columns)
    number = np.column_stack([number[:, 1:], number.min(axis=1) + columns * chosen.any(axis=1)])
    ahead = np.minimum.accumulate(number[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.minimum(np.where(ahead >= columns, number[:, -1:], ahead), 2 * columns) % columns)


def _senses(normals: Floats, triangles: Integers) -> Floats:
    """(n,) signs by which normals (n, 3) agree along the triangles' edges of the smallest turns."""
    n = len(normals)
    edges, _ = unique_edges(triangles)
    turn = 1 - np.abs(np.einsum("ex,ex->e", normals[edges[:, 0]], normals[edges[:, 1]]))
    # Add a little, because a sparse matrix drops edges of zero turn. Indices have 4 bytes, because scipy 1.15, the last
    # version for Python 3.10, takes no others.
    graph = scipy.sparse.coo_array((turn + 1e-3, edges.T.astype(np.int32)), shape=(n, n)).tocsr()
    tree = scipy.sparse.csgraph.minimum_spanning_tree(graph)
    tree = tree + tree.T
    parent = np.arange(n)
    _, component = scipy.sparse.csgraph.connected_components(tree, directed=False)
    for root in np.unique(component, return_index=True)[1]:
        order, before = scipy.sparse.csgraph.breadth_first_order(tree, root, directed=False)
        parent[order[1:]] = before[order[1:]]
    sense = np.where(np.einsum("nx,nx->n", normals, normals[parent]) < 0, -1.0, 1.0)
    while not np.array_equal(parent, parent[parent]):
        sense, parent = sense * sense[parent], parent[parent]
    return np.asarray(sense * sense[parent])


def _manifold(triangles: Integers, order: Integers, points: Floats, normals: Floats) -> Integers:
    """(t, 3) select triangles (m, 3) that share each edge with at most one other, and wind them by normals (n, 3).

    They are selected in the given order (m,).
    """
    facing = np.einsum("mx,mcx->mc", area_normals(points, triangles), normals[triangles])
    sense = np.sign(facing).sum(axis=1)
    turned = np.where(sense[:, None] < 0, triangles[:, ::-1], triangles)
    rank = np.argsort(order)
    half_edges = turned * len(points) + np.roll(turned, -1, axis=1)
    half_edge = np.unique(half_edges, return_inverse=True)[1].reshape(-1, 3)
    free = np.ones(half_edge.max(initial=-1) + 1, dtype=bool)
    taken = np.zeros(len(triangles), dtype=bool)
    left = np.flatnonzero(np.abs(sense) == 3)
    while len(left):
        # Select all triangles at once that come first at each of their edges.
        foremost = np.full(len(free), len(triangles))
        np.minimum.at(foremost, half_edge[left].ravel(), np.repeat(rank[left], 3))
        first = (foremost[half_edge[left]] == rank[left, None]).all(axis=1)
        taken[left[first]] = True
        free[half_edge[left[first]].ravel()] = False
        left = left[~first]
        left = left[free[half_edge[left]].all(axis=1)]
    return turned[taken]
