# SPDX-License-Identifier: GPL-3.0-or-later
"""Shortest paths along the target's edges that follow lines of the source.

The target is mapped onto the source to measure distances from a line there. A step of a path costs its length, or the
length of the line between its ends if that is longer. In the second case the difference is added once again, so that no
path skips from one reach of a line to another. The cost grows with the distance from the line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Indices, Integers
from zoomout_core.runtime.threads import threads
from zoomout_core.transfer.edges.edge_graph import EdgeGraph, LocatedPoints, MappedGraph
from zoomout_core.transfer.edges.polylines import PolylineSamples
from zoomout_core.transfer.groups import expand_ranges, find

# Points of lines that are traced together; bounds the memory.
BLOCK = 1 << 16
# Maximum gap of a line that is bridged, in edges of the target; shorter pieces between gaps are dropped.
MAX_GAP = 4.0
# Distances, in edges of the target, that a path may leave the faces crossed by its line. The next is tried if there is
# no path, because the map tears these faces apart.
SEARCH_RINGS = (2, 4, 8)
# Added to the cost of a step, relative to its length, for each edge length of distance from the line.
DISTANCE_COST = 2.0
# Length of a path relative to its line above which it is rejected: it goes around a tear of the map.
MAX_DETOUR = 3.0


class LinePieces(NamedTuple):
    """Parts of lines, each of which becomes a path."""

    first: Integers  # (p,) the first sample of each
    last: Integers  # (p,) the last sample of each
    loose_first: Booleans  # (p,) whether its line begins there, without a connecting line
    loose_last: Booleans  # (p,) whether its line ends there, without a connecting line


class PathSteps(NamedTuple):
    """Steps of paths along edges of the target's graph."""

    piece: Integers  # (t,) the piece of the path
    graph_edge: Integers  # (t,) the edge of the graph
    sample: Integers  # (t,) the nearest sample of the line
    stray: Floats  # (t,) distance of the edge's ends from the line


@dataclass(frozen=True, eq=False)
class LocatedLines:
    """Samples of the source's lines, their places on the target, and the target's graph."""

    samples: PolylineSamples
    place: LocatedPoints
    graph: MappedGraph


class _Band(NamedTuple):
    """Vertices of the target's graph around lines: one node for each piece and each vertex near it."""

    number: Integers  # (n,) `piece * k + vertex` for k vertices of the graph, ascending
    piece: Integers  # (n,) number of the piece, among the chosen ones
    vertex: Integers  # (n,) vertex of the graph
    sample: Integers  # (n,) the nearest sample of the piece
    along: Floats  # (n,) position of the line's nearest point along it
    stray: Floats  # (n,) distance of that point


def find_paths(pieces: LinePieces, lines: LocatedLines) -> PathSteps:
    """Steps of the paths of all pieces, found in blocks; pieces without a path are tried again with more room."""
    none = np.zeros(0, dtype=np.int64)
    parts = [PathSteps(none, none, none, np.zeros(0))]
    nearest, left = lines.place.nearest, np.arange(len(pieces.first))
    for rings in SEARCH_RINGS:
        block_of = np.cumsum((pieces.last - pieces.first + 1)[left]) // BLOCK
        blocks = [left[block_of == block] for block in np.unique(block_of)]
        parts += [_paths_of(block, rings, pieces, lines) for block in blocks]
        moving = nearest[pieces.first[left]] != nearest[pieces.last[left]]
        left = np.setdiff1d(left[moving], np.concatenate([part.piece for part in parts]))
    return PathSteps(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _paths_of(chosen: Integers, rings: int, pieces: LinePieces, lines: LocatedLines) -> PathSteps:
    """Steps of the paths of chosen pieces (p,), each in its own graph of the vertices around its line."""
    graph, along = lines.graph, lines.samples.along
    first, last = pieces.first[chosen], pieces.last[chosen]
    band = _band_around(first, last, rings, lines)
    own_first = np.arange(len(chosen)) * len(graph.edge_graph.surface_vertex)  # the number of each piece's vertex 0
    begin, end = (np.searchsorted(band.number, own_first + lines.place.nearest[at]) for at in (first, last))
    costs = _step_costs(band, graph)
    _, before, _ = dijkstra(costs, directed=False, indices=begin, return_predecessors=True, min_only=True)
    step = _walk_back(before, end[end != begin])
    piece, graph_edge = band.piece[step[:, 0]], graph.edge_graph.edge_between(band.vertex[step])
    length = np.bincount(piece, graph.scale * graph.edge_graph.lengths[graph_edge], minlength=len(chosen))
    direct = length <= MAX_DETOUR * (along[last] - along[first]) + MAX_GAP * graph.edge_length
    kept = direct[piece]
    step = step[kept]
    return PathSteps(
        chosen[piece[kept]], graph_edge[kept], band.sample[step].sum(axis=1) // 2, band.stray[step].sum(axis=1)
    )


def _band_around(first: Integers, last: Integers, rings: int, lines: LocatedLines) -> _Band:
    """Vertices of the target's graph up to some rings of edges around pieces.

    Args:
        first: (p,) the first sample of each piece.
        last: (p,) the last sample of each piece.
        rings: number of edges from the triangles that the line crosses.
        lines: the lines.
    """
    edge_graph, place = lines.graph.edge_graph, lines.place
    count = len(edge_graph.surface_vertex)
    piece, index = expand_ranges(first, last + 1)
    met = np.column_stack([place.vertices[index], place.nearest[index]])
    number = _grow(np.unique(piece[:, None] * count + met), rings, edge_graph)
    owner, vertex = np.divmod(number, count)
    return _Band(number, owner, vertex, *_beside(owner, lines.graph.points[vertex], piece, index, lines.samples))


def _step_costs(band: _Band, graph: MappedGraph) -> csr_array:
    """(n, n) costs of the steps between the nodes of a band, in one direction of each edge."""
    start, graph_edges, other = graph.edge_graph.around
    count = len(graph.edge_graph.surface_vertex)
    node, entry = expand_ranges(start[band.vertex], start[band.vertex + 1])
    there = find(band.number, band.piece[node] * count + other[entry])
    inside = there > node
    a, b, graph_edge = node[inside], there[inside], graph_edges[entry[inside]]
    passed = np.abs(band.along[a] - band.along[b])  # of the line
    direct = np.linalg.norm(graph.points[band.vertex[a]] - graph.points[band.vertex[b]], axis=1)
    away = (band.stray[a] + band.stray[b]) / (2 * graph.edge_length)
    walked = np.maximum(graph.scale * graph.edge_graph.lengths[graph_edge], passed)
    cost = walked * (1 + DISTANCE_COST * away) + np.maximum(passed - direct, 0)
    cost = np.maximum(cost, 1e-9 * graph.edge_length)  # zeros would be missing edges
    return csr_array((cost, (a, b)), shape=(len(band.number), len(band.number)))


def _walk_back(before: Indices, ends: Integers) -> Integers:
    """(t, 2) steps of paths from their ends (p,) back to their beginnings.

    Args:
        before: (n,) predecessor of each node on its path, negative for beginnings and unreached nodes.
        ends: (p,) last node of each path.
    """
    steps = [np.zeros((0, 2), dtype=np.int64)]
    here = ends[before[ends] >= 0]
    while len(here):
        steps.append(np.stack([before[here], here], axis=1))
        here = before[here]
        here = here[before[here] >= 0]
    return np.concatenate(steps)


def _grow(nodes: Integers, rings: int, edge_graph: EdgeGraph) -> Integers:
    """Add the vertices up to some edges away to ascending numbers `piece * k + vertex`."""
    start, _, other = edge_graph.around
    count = len(edge_graph.surface_vertex)
    for _ in range(rings):
        owner, vertex = np.divmod(nodes, count)
        node, entry = expand_ranges(start[vertex], start[vertex + 1])
        nodes = np.unique(np.concatenate([nodes, owner[node] * count + other[entry]]))
    return nodes


def _beside(
    owner: Integers, points: Floats, piece: Integers, index: Integers, samples: PolylineSamples
) -> tuple[Integers, Floats, Floats]:
    """Locate points relative to the lines of their pieces.

    Args:
        owner: (n,) the piece of each point.
        points: (n, 3) positions on the source.
        piece: (q,) the piece of each sample.
        index: (q,) the number of each sample.
        samples: all samples.

    Returns:
        (n,) the nearest sample, (n,) the position of the line's nearest point along it, and (n,) its distance.
    """
    # Pieces are far apart in a fourth dimension, so that each point finds its own piece.
    apart = 2 * float(np.linalg.norm(np.ptp(np.concatenate([points, samples.point[index]]), axis=0)))
    tree = cKDTree(np.column_stack([samples.point[index], piece * apart]))
    _, found = tree.query(np.column_stack([points, owner * apart]), workers=threads())
    nearest, along = index[found], samples.along[index[found]]
    stray = np.linalg.norm(samples.point[nearest] - points, axis=1)
    for step in (-1, 1):
        beside = np.clip(found + step, 0, len(index) - 1)
        beside = index[np.where(piece[beside] == owner, beside, found)]
        way = samples.point[beside] - samples.point[nearest]
        square = np.einsum("nx,nx->n", way, way)
        share = np.einsum("nx,nx->n", points - samples.point[nearest], way) / np.maximum(square, 1e-300)
        share = np.clip(share, 0, 1)
        distance = np.linalg.norm(samples.point[nearest] + share[:, None] * way - points, axis=1)
        closer = distance < stray
        there = samples.along[nearest] + share * (samples.along[beside] - samples.along[nearest])
        along, stray = np.where(closer, there, along), np.where(closer, distance, stray)
    return nearest, along, stray
