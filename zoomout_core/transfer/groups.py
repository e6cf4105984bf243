# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbered items in groups: ranges, the first of each group, places in sorted numbers, and joined pairs."""

from __future__ import annotations

import numpy as np
import scipy

from zoomout_core.arrays import Floats, Indices, Integers


def group_starts(group: Indices) -> Integers:
    """(g,) where each group begins in the groups (q,) of items that are ordered by group."""
    return np.flatnonzero(np.diff(group, prepend=-1))


def first_of_each(group: Indices, *keys: Floats | Integers) -> Integers:
    """(g,) the item of each group (q,) with the smallest keys, (q,) each; the last key counts most."""
    order = np.lexsort((*keys, group))
    return order[group_starts(group[order])]


def expand_ranges(start: Integers, end: Integers) -> tuple[Integers, Integers]:
    """The numbers from start (r,) up to end (r,) of each range: (q,) the range of each, and (q,) the numbers."""
    count = end - start
    owner = np.repeat(np.arange(len(count)), count)
    return owner, np.arange(len(owner)) + (start - np.cumsum(count) + count)[owner]


def find(keys: Integers, wanted: Integers) -> Integers:
    """The positions of wanted numbers, all zero or more, among ascending keys (k,); -1 for missing ones."""
    place = np.searchsorted(keys, wanted)
    return np.where(np.append(keys, -2)[place] == wanted, place, -1)


def label_groups(count: int, first: Integers, second: Integers) -> Integers:
    """(count,) number of each item's group, after joining the pairs (first, second)."""
    graph = scipy.sparse.coo_array((np.ones(len(first), dtype=bool), (first, second)), shape=(count, count))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)
