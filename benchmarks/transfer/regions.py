# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of a surface, used for UV islands, bones and patches of materials."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, dijkstra, minimum_spanning_tree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import edge_graph, triangle_areas, unique_edges
from zoomout_core.samples.skeletons import BoneRow
from zoomout_core.spectral.sampling import farthest_points

# Length of a bone at the end of a limb, relative to the distance to the centre of its region.
BEYOND = 1.6
# Regions deeper than this, relative to the square root of their area, are cut open.
DEEP = 0.7


def regions(vertices: Floats, triangles: Integers, count: int) -> Integers:
    """(n,) for each vertex the geodesically nearest of `count` evenly spread places."""
    places = farthest_points(vertices, count)
    _, _, nearest = dijkstra(edge_graph(vertices, triangles), indices=places, min_only=True, return_predecessors=True)
    number = np.zeros(len(vertices), dtype=np.int64)
    number[places] = np.arange(len(places))
    return number[nearest]


def faces_of(region: Integers, triangles: Integers) -> Integers:
    """(m,) the region of each triangle: that of two of its corners, or the smallest index."""
    a, b, c = region[triangles].T
    return np.where((a == b) | (a == c), a, np.where(b == c, b, np.minimum(np.minimum(a, b), c)))


def islands(vertices: Floats, triangles: Integers, region: Integers) -> Booleans:
    """(e,) which of `unique_edges` are seams, so that every region of triangles (m,) can be unwrapped.

    Seams separate regions; a region with several borders, such as a sleeve, is cut from one to the next, and
    a deep one, such as a mitten, to its tip.
    """
    edges, edge_of = unique_edges(triangles)
    low, high = np.full(len(edges), region.max()), np.zeros(len(edges), dtype=np.int64)
    np.minimum.at(low, edge_of, region[:, None])
    np.maximum.at(high, edge_of, region[:, None])
    seam = low != high
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    for number in range(region.max() + 1):
        inside = np.unique(edge_of[region == number])
        area = triangle_areas(vertices, triangles[region == number]).sum()
        seam[inside] = _cut_to_flatten(edges[inside], length[inside], seam[inside], DEEP * np.sqrt(area))
    return seam


def _cut_to_flatten(edges: Integers, length: Floats, seam: Booleans, depth: float) -> Booleans:
    """(k,) the seams of a region, with added cuts that join all its borders and reach deep into its interior.

    Args:
        edges: (k, 2) the region's edges, including its border.
        length: (k,) their lengths.
        seam: (k,) which of them are on its border.
        depth: maximum distance of a vertex from a seam.
    """
    vertex, local = np.unique(edges, return_inverse=True)
    ends, size = local.reshape(-1, 2), len(vertex)
    number = coo_array((np.arange(1, len(ends) + 1), tuple(ends.T)), shape=(size, size)).tocsr()
    number = number + number.T
    ways = coo_array((length, tuple(ends.T)), shape=(size, size)).tocsr()
    seam = seam.copy()
    while seam.any():
        graph = coo_array((np.ones(seam.sum()), tuple(ends[seam].T)), shape=(size, size))
        on_seam = np.unique(ends[seam])
        first = breadth_first_order(graph, on_seam[0], directed=False, return_predecessors=False)
        distance, before, _ = dijkstra(ways, directed=False, indices=first, min_only=True, return_predecessors=True)
        rest = np.setdiff1d(on_seam, first)
        at = rest[np.argmin(distance[rest])] if len(rest) else int(np.argmax(distance))
        if not np.isfinite(distance[at]) or (len(rest) == 0 and distance[at] <= depth):
            break
        while before[at] >= 0:
            seam[number[at, before[at]] - 1] = True
            at = before[at]
    return seam


def bones(vertices: Floats, triangles: Integers, region: Integers) -> list[BoneRow]:
    """A skeleton with a bone inside each region (n,) of vertices, joined at the borders of regions."""
    count = int(region.max()) + 1
    edges, _ = unique_edges(triangles)
    crossing = edges[region[edges[:, 0]] != region[edges[:, 1]]]
    pair = np.sort(region[crossing], axis=1)
    which, inverse, met = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
    joint = np.zeros((len(which), 3))
    np.add.at(joint, inverse.reshape(-1), vertices[crossing].mean(axis=1))
    joint /= met[:, None]
    tree = minimum_spanning_tree(coo_array((1 / met, tuple(which.T)), shape=(count, count)))
    middle = np.stack([np.bincount(region, axis) for axis in vertices.T], axis=1) / np.bincount(region)[:, None]
    root = int(np.argmin(np.linalg.norm(middle - vertices.mean(axis=0), axis=1)))
    order, parent = breadth_first_order(tree, root, directed=False)
    between = {tuple(row): place for row, place in zip(which.tolist(), joint, strict=True)}
    heads = {int(i): middle[i] if parent[i] < 0 else between[tuple(sorted((int(i), int(parent[i]))))] for i in order}
    rows = []
    for i in order.tolist():
        children = [heads[j] for j in order.tolist() if parent[j] == i]
        tail = np.mean(children, axis=0) if children else heads[i] + BEYOND * (middle[i] - heads[i])
        above = None if parent[i] < 0 else f"bone_{parent[i]}"
        rows.append(BoneRow(f"bone_{i}", above, tuple(heads[i].tolist()), tuple(tail.tolist())))
    return rows
