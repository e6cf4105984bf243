# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose a label for each vertex of a mesh, with short borders between labels, by graph cuts.

The energy sums the vertices' costs and the length of the borders (a Potts model). It is minimised by expansion moves:
Boykov, Veksler and Zabih, Fast approximate energy minimization via graph cuts (2001). The length of a border is
computed from the edges that it cuts, by the formula of Cauchy and Crofton: Boykov and Kolmogorov, Computing geodesics
and minimal surfaces via graph cuts (2003). The edges connect vertices within two rings, so that the length depends
little on their directions.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from zoomout_core.arrays import Booleans, Floats, Integers

# Rounds over all labels: the energy hardly falls after the second one.
ROUNDS = 3
# Largest flow, and largest capacity of a link, in units of their rounding: both ways of a link fit into 32 bits.
CAPACITY = 1 << 29


def border_lengths(vertices: Floats, areas: Floats, graph: csr_array) -> csr_array:
    """(n, n) the length of border that separates two vertices, one or two edges apart; symmetric.

    Args:
        vertices: (n, 3) positions.
        areas: (n,) of the vertices.
        graph: (n, n) adjacency along edges.
    """
    near = coo_array(graph @ graph + graph)
    apart = np.linalg.norm(vertices[near.row] - vertices[near.col], axis=1)
    width = areas / np.maximum(np.bincount(near.row, near.row != near.col, minlength=len(vertices)), 1)
    length = np.divide(width[near.row] + width[near.col], apart, out=np.zeros(len(apart)), where=apart > 0)
    return csr_array((np.pi / 2 * length, (near.row, near.col)), shape=near.shape)


def shorten_borders(vertex: Integers, label: Integers, cost: Floats, length: csr_array) -> Integers:
    """Choose one of the candidate labels of each vertex; the sum of costs and of the lengths of borders is small.

    Args:
        vertex: (k,) the vertex of each candidate, ascending; every vertex from 0 to n - 1 has one.
        label: (k,) its label.
        cost: (k,) of the vertex with this label, in lengths of border.
        length: (n, n) the length of border between two vertices if their labels differ; symmetric.

    Returns:
        (n,) the chosen candidate of each vertex.
    """
    order = np.lexsort((cost, vertex))
    chosen = order[np.flatnonzero(np.diff(vertex[order], prepend=-1))]
    by_label = np.argsort(label, kind="stable")
    numbers, start = np.unique(label[by_label], return_index=True)
    candidates = dict(zip(numbers.tolist(), np.split(by_label, start[1:]), strict=True))
    fresh = numbers
    for _ in range(ROUNDS):
        before = chosen.copy()
        for number in fresh.tolist():
            options = candidates[number]
            options = options[label[chosen[vertex[options]]] != number]
            if len(options):
                taken = options[_expand(options, chosen, label, vertex, cost, length)]
                chosen[vertex[taken]] = taken
        changed = before != chosen
        if not changed.any():
            break
        fresh = np.unique(label[np.concatenate([before[changed], chosen[changed]])])
    return chosen


def _expand(
    options: Integers, chosen: Integers, label: Integers, vertex: Integers, cost: Floats, length: csr_array
) -> Booleans:
    """(q,) whether to take each of the candidates, all of one label, in the best expansion of this label."""
    count, at = len(options), vertex[options]
    around = coo_array(length[at])
    p, beside, pair = around.row, around.col, around.data
    q = np.minimum(np.searchsorted(at, beside), count - 1)
    own, theirs = label[chosen[at]][p], label[chosen[beside]]
    fixed = at[q] != beside  # these keep their labels
    change = np.where(fixed, (theirs != label[options[0]]) * 1.0 - (theirs != own), 0.0)
    # Two vertices of different labels are apart unless both take the new one.
    apart = ~fixed & (own != theirs) & (p < q)
    together = ~fixed & (own == theirs)
    surplus = cost[options] - cost[chosen[at]] + np.bincount(p, pair * change, minlength=count)
    surplus -= np.bincount(q[apart], pair[apart], minlength=count)
    if (surplus >= 0).all():
        return np.zeros(count, dtype=bool)
    linked = together | apart
    p, q, pair = p[linked], q[linked], pair[linked]
    # A vertex whose surplus exceeds its links is decided: more would only make the rounding coarser.
    links = np.bincount(p, pair, minlength=count) + np.bincount(q, pair, minlength=count)
    decided = 2 * links + (around.data.max() or 1.0)
    surplus = np.clip(surplus, -decided, decided)
    every = np.arange(count)
    rows = np.concatenate([p, np.full(count, count), every])
    columns = np.concatenate([q, every, np.full(count, count + 1)])
    keep, change = np.maximum(surplus, 0), np.maximum(-surplus, 0)
    capacity = np.concatenate([pair, keep, change])
    scale = CAPACITY / max(capacity.max(), min(keep.sum(), change.sum()))
    network = csr_array((np.rint(capacity * scale).astype(np.int32), (rows, columns)), shape=(count + 2,) * 2)
    residual = network - maximum_flow(network, count, count + 1).flow
    residual.data = np.maximum(residual.data, 0)
    residual.eliminate_zeros()
    # Vertices that reach the sink where capacity is left; others keep their labels, also in ties.
    taken = np.zeros(count + 2, dtype=bool)
    taken[breadth_first_order(residual.T.tocsr(), count + 1, return_predecessors=False)] = True
    return taken[:count]
