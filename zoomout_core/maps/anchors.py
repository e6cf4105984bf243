# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that keep a map in place where spectra alone would let it drift (anchored ZoomOut)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class Anchors:
    """Functions that should agree under the map, such as distances to landmarks.

    They are appended to the spectral coordinates in every nearest-neighbour search. This keeps the map in place where
    the spectra of two shapes have little in common.

    Attributes:
        source: (n_s, m) values at the source's vertices.
        target: (n_t, m) values at the target's vertices, on the same scale.
    """

    source: Floats
    target: Floats

    def at(self, source_vertices: Integers, target_vertices: Integers) -> Anchors:
        """The anchors at some of the vertices, (q_s,) of the source and (q_t,) of the target."""
        return Anchors(self.source[source_vertices], self.target[target_vertices])

    def join(self, others: Anchors | None) -> Anchors:
        """Combine these anchors with others, if any."""
        if others is None:
            return self
        return Anchors(np.hstack([self.source, others.source]), np.hstack([self.target, others.target]))

    def scale(self, factor: float) -> Anchors:
        """Scale the weight of the anchors."""
        return Anchors(factor * self.source, factor * self.target)

    def swap(self) -> Anchors:
        """The anchors of the map in the other direction."""
        return Anchors(self.target, self.source)


def beside(rows: Floats, anchors: Floats) -> Floats:
    """Append anchors (n, m) to spectral coordinates (n, k), with equal weight of both in a distance."""
    return np.hstack([rows, anchors * np.sqrt(rows.shape[1] / anchors.shape[1])])


def coordinates(
    target_rows: Floats, source_rows: Floats, functional_map: Floats, anchors: Anchors | None = None
) -> tuple[Floats, Floats]:
    """Coordinates (q, d) of places of the target and (p, d) of the source in which corresponding places are close.

    They come from the eigenfunctions (q, k) and (p, k) and the anchors at these places, and a functional map
    (..., k_target, k_source).
    """
    k_target, k_source = functional_map.shape[-2:]
    queries, embedded = target_rows[:, :k_target], source_rows[:, :k_source] @ np.swapaxes(functional_map, -1, -2)
    if anchors is None:
        return queries, embedded
    return beside(queries, anchors.target), beside(embedded, anchors.source)
