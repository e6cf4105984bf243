# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of marked edges on a surface, and points along them.

Marked edges are joined to chains that lead from a junction or end to the next, or around a loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.groups import expand_ranges, group_starts, label_groups


@dataclass(frozen=True, eq=False)
class Polylines:
    """Edges joined to chains, ordered by chain and along each."""

    edge: Integers  # (k,) numbers of the edges
    chain: Integers  # (k,) the chain of each
    begin: Integers  # (k,) the first vertex of each, along its chain
    end: Integers  # (k,) the last vertex of each


@dataclass(frozen=True, eq=False)
class PolylineSamples:
    """Points along chains, ordered by chain and along each, from its first vertex to its last."""

    chain: Integers  # (q,) the chain of each
    along: Floats  # (q,) the length of the chain up to each
    point: Floats  # (q, 3) the position of each
    edge: Integers  # (q,) the edge that contains each
    vertex: Integers  # (q,) the vertex at each, -1 between vertices


def polylines_of(edges: Integers) -> Polylines:
    """Join edges (k, 2), each pair of vertices at most once, to polylines that end where not exactly two meet."""
    count = len(edges)
    ends = edges.ravel()
    # A vertex between two edges is one node; elsewhere every edge ends in a separate node.
    vertex_count = int(ends.max(initial=-1)) + 1
    inner = np.bincount(ends, minlength=vertex_count)[ends] == 2
    node = np.where(inner, ends, vertex_count + np.arange(2 * count))
    nodes, number = np.unique(node, return_inverse=True)
    chain = label_groups(len(nodes), number[::2], number[1::2])[number]
    # A loop has no end: it is opened where its first edge begins.
    closed = np.ones(chain.max(initial=-1) + 1, dtype=bool)
    closed[chain[~inner]] = False
    first = np.unique(chain, return_index=True)[1][closed]
    node[first] = vertex_count + first
    outer = np.flatnonzero(node >= vertex_count)
    start = node[outer[np.unique(chain[outer], return_index=True)[1]]]
    nodes, number = np.unique(node, return_inverse=True)
    steps = coo_array((np.ones(count), (number[::2], number[1::2])), shape=(len(nodes), len(nodes))).tocsr()
    rank = dijkstra(steps, directed=False, indices=np.searchsorted(nodes, start), min_only=True) if count else nodes
    rank = rank[number].reshape(-1, 2)
    forward = rank[:, 0] < rank[:, 1]
    order = np.lexsort((rank.min(axis=1), chain[::2]))
    directed = np.where(forward[:, None], edges, edges[:, ::-1])[order]
    return Polylines(order, chain[::2][order], directed[:, 0], directed[:, 1])


def sample(chains: Polylines, vertices: Floats, spacing: float) -> PolylineSamples:
    """Sample points along chains on vertices (n, 3), including all of their vertices, at most `spacing` apart."""
    begin, end = vertices[chains.begin], vertices[chains.end]
    length = np.linalg.norm(end - begin, axis=1)
    parts = np.maximum(np.ceil(length / spacing), 1).astype(np.int64)
    last = np.append(chains.chain[1:] != chains.chain[:-1], True)[: len(parts)]
    on, step = expand_ranges(np.zeros_like(parts), parts + last)
    share = step / parts[on]
    before = np.cumsum(length) - length
    first = np.append(True, last[:-1])[: len(parts)]
    before -= before[np.flatnonzero(first)][np.cumsum(first) - 1]
    vertex = np.where(step == 0, chains.begin[on], np.where(step == parts[on], chains.end[on], -1))
    return PolylineSamples(
        chain=chains.chain[on],
        along=before[on] + share * length[on],
        point=begin[on] + share[:, None] * (end - begin)[on],
        edge=chains.edge[on],
        vertex=vertex,
    )


def runs(chain: Integers, state: Booleans) -> tuple[Integers, Integers, Integers]:
    """Runs of equal states within one chain: (q,) the run of each sample, (r,) the first and (r,) the last of each."""
    changes = (np.diff(chain) != 0) | (np.diff(state.astype(np.int8)) != 0)
    run = np.concatenate([[0], np.cumsum(changes)])[: len(chain)]
    first = group_starts(run)
    return run, first, np.append(first[1:], len(run))[: len(first)] - 1
