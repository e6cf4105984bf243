# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles, edges and vertices of a mesh are adjacent: edges, quads of two triangles, lists of neighbours."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Integers


class Lists:
    """Lists of entries (e,). List n begins at `start[n]` and ends before `start[n + 1]`."""

    def __init__(self, entries: Integers, start: Integers) -> None:
        self.entries, self.start = entries, start

    def count(self, chosen: Integers) -> Integers:
        """(k,) the lengths of lists."""
        return self.start[chosen + 1] - self.start[chosen]

    def of(self, chosen: Integers) -> tuple[Integers, Integers]:
        """The entries of chosen lists (k,): (q,) the position of each entry's list in `chosen`, and the entries."""
        count = self.count(chosen)
        which = np.repeat(np.arange(len(chosen)), count)
        within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        return which, self.entries[self.start[chosen][which] + within]


class Edges:
    """The edges of triangles (m, 3) of n vertices whose corners have data (m, 3).

    Attributes:
        ends: (e, 2) vertex numbers, the smaller first, in ascending order.
        key: (e,) a number for both.
        of_half: (3 m,) the edge of each side of the triangles: all first sides, then all second and third ones.
        sides: (e, 2) the sides of triangles that each edge is, -1 where there are not two.
        is_line: (e,) whether it is a border or a seam.
        is_odd: (e,) whether it has more than two triangles.
    """

    def __init__(self, triangles: Integers, wedge: Integers, n: int) -> None:
        tail, head = triangles.T.ravel(), np.roll(triangles, -1, axis=1).T.ravel()
        of_tail, of_head = wedge.T.ravel(), np.roll(wedge, -1, axis=1).T.ravel()
        swapped = tail > head
        low, high = np.where(swapped, of_head, of_tail), np.where(swapped, of_tail, of_head)
        start, stop = np.minimum(tail, head), np.maximum(tail, head)
        by_stop, _ = group_by_key(stop, n)
        order = by_stop[group_by_key(start[by_stop], n)[0]]
        key = start[order] * n + stop[order]
        first = np.flatnonzero(np.diff(key, prepend=-1))
        count = np.diff([*first, len(key)])
        edge = np.repeat(np.arange(len(first)), count)
        self.n, self.key = n, key[first]
        self.ends = np.column_stack(np.divmod(self.key, n))
        self.of_half = np.empty(len(key), dtype=np.int64)
        self.of_half[order] = edge
        two = np.flatnonzero(count == 2)
        self.sides = np.full((len(first), 2), -1)
        self.sides[two] = order[first[two][:, None] + [0, 1]]
        low, high = low[order], high[order]
        differs = (low != low[first][edge]) | (high != high[first][edge])
        self.is_line = count == 1
        self.is_line[edge[differs]] = True
        self.is_odd = count > 2

    def find(self, one: Integers, other: Integers) -> Integers:
        """(k,) numbers of the edges between vertices, -1 for none."""
        key = np.minimum(one, other) * self.n + np.maximum(one, other)
        return find_sorted(self.key, key)

    def count_common(self, one: Integers, other: Integers) -> Integers:
        """(k,) the numbers of vertices that are neighbours of both vertices."""
        which, neighbour = self.neighbours.of(one)
        goal = other[which]
        apart = neighbour != goal
        which, neighbour, goal = which[apart], neighbour[apart], goal[apart]
        return np.bincount(which[self.find(neighbour, goal) >= 0], minlength=len(one))

    @cached_property
    def across(self) -> Integers:
        """(m, 3) the triangle beyond each side of the triangles, -1 for none or several."""
        pairs = self.sides[self.sides[:, 0] >= 0]
        across = np.full(len(self.of_half), -1)
        across[pairs] = pairs[:, ::-1] % (len(across) // 3)
        return across.reshape(3, -1).T

    @cached_property
    def neighbours(self) -> Lists:
        """The neighbours of each vertex."""
        order, start = group_by_key(self.ends.T.ravel(), self.n)
        return Lists(self.ends[:, ::-1].T.ravel()[order], start)


class Quads:
    """The q pairs of triangles (m, 3) that share an edge which is not a line.

    Attributes:
        triangles: (q, 2) their numbers.
        vertices: (q, 4) the vertices around the quad that they make; the edge is between the first and the third one.
        of_edge: (e,) the quad of each edge, -1 for none.
    """

    def __init__(self, triangles: Integers, edges: Edges) -> None:
        count = len(triangles)
        edge = np.flatnonzero((edges.sides[:, 0] >= 0) & ~edges.is_line)
        side, self.triangles = np.divmod(edges.sides[edge], count)
        # The places, in each triangle, of the tail and the head of its side, and of the vertex beyond.
        (tail, back), (head, _), (beyond, before) = ((side + step).T % 3 for step in range(3))
        first, second = self.triangles.T
        self._places = np.stack([tail, before, head, beyond], axis=1)
        self.vertices = triangles[self._owners, self._places]
        turned = triangles[second, back] != triangles[first, head]  # the two face different sides
        self.triangles, self._places = self.triangles[~turned], self._places[~turned]
        self.vertices = self.vertices[~turned]
        self.of_edge = np.full(len(edges.ends), -1)
        self.of_edge[edge[~turned]] = np.arange(len(self.vertices))

    @property
    def _owners(self) -> Integers:
        """(q, 4) the triangle in which each vertex is looked up."""
        return self.triangles[:, [0, 1, 0, 0]]

    def corners_of(self, corners: Integers, chosen: Integers) -> Integers:
        """(k, 4) the corners, of those (m, 3) of the triangles, of chosen quads (k,)."""
        return np.asarray(corners[self._owners[chosen], self._places[chosen]])

    def touch_once(self, chosen: Integers, count: int) -> Booleans:
        """(k,) which of these quads share none of the `count` triangles with an earlier one."""
        order = np.arange(len(chosen))
        owner = np.full(count, len(chosen))
        for each in self.triangles[chosen].T:
            np.minimum.at(owner, each, order)
        return np.asarray((owner[self.triangles[chosen]] == order[:, None]).all(axis=1))


def find_sorted(values: Integers, wanted: Integers) -> Integers:
    """(k,) the places of numbers (k,) among ascending values (n,), the first of equal ones; -1 for none."""
    if not len(values):
        return np.full(len(wanted), -1)
    at = np.minimum(np.searchsorted(values, wanted), len(values) - 1)
    return np.where(values[at] == wanted, at, -1)


def group_by_key(keys: Integers, count: int) -> tuple[Integers, Integers]:
    """A stable order of keys (k,) below `count`, and where each key begins in it (count + 1,)."""
    entries = np.arange(len(keys)), keys, np.arange(len(keys) + 1)
    table = csr_array(entries, shape=(len(keys), count)).tocsc()
    return table.data, table.indptr.astype(np.int64)
