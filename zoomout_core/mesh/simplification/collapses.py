# SPDX-License-Identifier: GPL-3.0-or-later
"""Collapses of edges: candidates with their costs, and what becomes of the corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.adjacency import find_sorted


@dataclass(frozen=True)
class Candidates:
    """Collapses of vertices `tail` (k,) into `head` (k,), the cheapest first.

    Attributes:
        cost: (k,) their errors.
        rank: (k,) their order, the same for mirror images.
        place: (k,) twice the number of the edge, and one more if `tail` is its second end.
    """

    tail: Integers
    head: Integers
    cost: Floats
    rank: Integers
    place: Integers


@dataclass(frozen=True)
class Costs:
    """The costs (e, 2) of collapses of the first and second end of edges, whose keys (e,) ascend.

    Attributes:
        fails: (e, 2) whether they were found to be impossible.
    """

    key: Integers
    cost: Floats
    fails: Booleans

    def find(self, key: Integers) -> Integers:
        """(k,) numbers of the edges with these keys, -1 for none."""
        return find_sorted(self.key, key)


class Partners:
    """Corners (k,) by the number of a collapse `which` (k,) and by the data `wedge` (k,) of another corner."""

    def __init__(self, which: Integers, wedge: Integers, corner: Integers, wedges: int) -> None:
        key = which * wedges + wedge
        order = np.argsort(key, kind="stable")
        self.key, self.corner, self.wedges = key[order], corner[order], wedges

    def find(self, which: Integers, wedge: Integers) -> Integers:
        """(k,) the corner for each collapse and data, -1 for none."""
        at = find_sorted(self.key, which * self.wedges + wedge)
        return np.where(at >= 0, self.corner[at], -1) if len(self.key) else at


def combine_layers(layers: Sequence[Integers], corner_count: int) -> Integers:
    """(corner_count,) numbers of the data of the corners in all of these layers (m, 3)."""
    wedge = np.zeros(corner_count, dtype=np.int64)
    for layer in layers:
        key = wedge * (int(layer.max(initial=0)) + 1) + layer.ravel()
        wedge = np.unique(key, return_inverse=True)[1].ravel()
    return wedge
