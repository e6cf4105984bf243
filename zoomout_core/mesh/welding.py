# SPDX-License-Identifier: GPL-3.0-or-later
"""Weld vertices that coincide up to rounding: at borders that exporters split, and of duplicated parts."""

from __future__ import annotations

import numpy as np
import scipy

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import Sides, components

# Vertices closer than this share of the surface's diameter coincide. Cells of a little more than a third of it need 21
# bits per coordinate.
TOLERANCE = 2.0**-20
# In cells with more distinct positions than this, only one is tested: a part is smaller than the tolerance.
CROWDED = 16


def weld(vertices: Floats, triangles: Integers, sides: Sides) -> Integers:
    """(n,) the vertex that replaces each of vertices (n, 3): the first of its group.

    Coincident borders are welded. So are parts that coincide with others triangle by triangle, such as the back sides
    of thin objects and forgotten copies. Elsewhere a surface may touch itself. Vertices closer than the tolerance are
    welded, and so are chains of them. The result does not depend on the frame.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    number = np.flatnonzero(used)
    points = vertices[number] - vertices[number].mean(axis=0)
    tolerance = 2 * float(np.linalg.norm(points, axis=1).max()) * TOLERANCE
    cell = _cells(points, tolerance)
    stands_for = np.arange(len(vertices))
    border = np.flatnonzero(_on_border(triangles, sides, len(vertices))[number])
    if len(border):
        stands_for[number[border]] = number[border[_clusters(points[border], cell[border], tolerance)]]
    apart = cell[stands_for[number] == number]
    if len(np.unique(apart)) == len(apart):
        return stands_for
    place = np.arange(len(vertices))
    place[number] = number[_clusters(points, cell, tolerance)]
    return _weld_copies(stands_for, place, triangles)


def repeated_triangles(triangles: Integers, sides: Sides) -> Booleans:
    """(m,) which triangles (m, 3) repeat the three vertices of an earlier one, in any order.

    Folds of a closed surface do not count: two other triangles join the edges of a fold, at most one those of a
    two-sided sheet.
    """
    side, first = sides
    opposite = np.roll(triangles, 1, axis=1).ravel()
    count = np.diff(first)
    pair = first[:-1][count == 2]
    doubled = pair[opposite[side[pair]] == opposite[side[pair + 1]]]
    among = np.unique(np.concatenate([side[doubled], side[np.repeat(count > 2, count)]]) // 3)
    _, begin, group, size = np.unique(
        np.sort(triangles[among], axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    group = np.where(size[group.ravel()] > 1, group.ravel(), -1)
    among, begin, group = among[group >= 0], among[begin], group[group >= 0]
    again = np.zeros(len(triangles), dtype=bool)
    if len(among):
        group_of = np.full(len(triangles), -1)
        group_of[among] = group
        again[among] = (among != begin[group]) & ~_folded_groups(triangles, sides, group_of, len(size))[group]
    return again


def _folded_groups(triangles: Integers, sides: Sides, group_of: Integers, groups: int) -> Booleans:
    """(g,) which groups of coincident triangles, numbered by (m,) with -1 for none, belong to a fold."""
    side, first = sides
    edge = np.repeat(np.arange(len(first) - 1), np.diff(first))
    group = group_of[side // 3]
    doubled = np.flatnonzero(group >= 0)
    others = np.bincount(edge, group < 0)
    # Groups of one sheet or fold are connected; edges are numbered after the groups in the graph.
    patch = components(np.stack([group[doubled], groups + edge[doubled]], axis=1), groups + len(others))
    folded = np.zeros(patch.max() + 1, dtype=bool)
    folded[patch[groups + edge[doubled[others[edge[doubled]] > 1]]]] = True
    there = group_of >= 0
    a, b, c = triangles[there].T
    turn = np.where((a < b).astype(int) + (b < c) + (c < a) == 2, 1, -1)
    balanced = np.bincount(group_of[there], turn, groups) == 0
    return np.asarray(balanced & folded[patch[:groups]])


def _on_border(triangles: Integers, sides: Sides, count: int) -> Booleans:
    """(n,) which vertices are on an edge of only one triangle."""
    side, first = sides
    alone = side[first[:-1][np.diff(first) == 1]]
    border = np.zeros(count, dtype=bool)
    border[triangles.ravel()[alone]] = True
    border[np.roll(triangles, -1, axis=1).ravel()[alone]] = True
    return border


def _cells(points: Floats, tolerance: float) -> Integers:
    """(n,) the cell of each point; points of one cell are at most the tolerance apart."""
    lattice = np.floor((points - points.min(axis=0)) * (np.sqrt(3) / tolerance)).astype(np.int64)
    return np.asarray((lattice[:, 0] << 42) | (lattice[:, 1] << 21) | lattice[:, 2])


def _clusters(points: Floats, cell: Integers, tolerance: float) -> Integers:
    """(n,) the first of the points (n, 3) that are connected with each by steps of at most the tolerance.

    Points of one cell (n,) are always connected.
    """
    _, begin, group = np.unique(cell, return_index=True, return_inverse=True)
    apart = (points != points[begin[group]]).any(axis=1)
    crowded = np.bincount(group, apart) > CROWDED
    chosen = np.concatenate([begin, np.flatnonzero(apart & ~crowded[group])])
    pairs = group[chosen[scipy.spatial.cKDTree(points[chosen]).query_pairs(tolerance, output_type="ndarray")]]
    return _first_of(components(pairs, len(begin))[group])


def _weld_copies(stands_for: Integers, place: Integers, triangles: Integers) -> Integers:
    """Weld parts that coincide wholly with others to these: (n,) the vertex that replaces each.

    Replacements (n,) at borders are known, and the first vertex (n,) at the same place.
    """
    own = stands_for[triangles]
    part = components(np.concatenate([own[:, :2], own[:, 1:]]), len(place))[own[:, 0]]
    largest_first = np.argsort(np.argsort(-np.bincount(part), kind="stable"))[part]
    corners = place[triangles]
    order = np.argsort(corners, axis=1)
    corners = np.take_along_axis(corners, order, axis=1)
    proper = np.flatnonzero((np.diff(corners, axis=1) > 0).all(axis=1))
    proper = proper[np.argsort(largest_first[proper], kind="stable")]
    _, begin, group = np.unique(corners[proper], axis=0, return_index=True, return_inverse=True)
    twin = proper[begin[group.ravel()]]  # of the largest part that has one
    lies_on_another = np.ones(part.max() + 1, dtype=bool)
    lies_on_another[part[proper[part[twin] == part[proper]]]] = False
    copied = lies_on_another[part[proper]]
    vertices = np.take_along_axis(triangles, order, axis=1)
    of_copy, of_other = vertices[proper[copied]].ravel(), vertices[twin[copied]].ravel()
    pairs = np.concatenate([np.stack([np.arange(len(place)), stands_for]), np.stack([of_copy, of_other])], axis=1)
    return _first_of(components(pairs.T, len(place)))


def _first_of(label: Integers) -> Integers:
    """(n,) the first element with the same label."""
    _, begin, group = np.unique(label, return_index=True, return_inverse=True)
    return np.asarray(begin[group])
