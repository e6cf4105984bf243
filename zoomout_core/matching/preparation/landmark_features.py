# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions of a few places on a shape: distances to them, and the handedness of pairs of them around each point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.spectral.descriptors import pseudo_scalars
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class LandmarkTuning(Tuning, set_by="correspondence"):
    """The functions of landmarks."""

    distance_spread: float = tuned(0.3, "1", 0.01, 10)  # deviation of a distance, relative to its mean
    distance_time: float = tuned(5e-4, "area, at unit area", 0, 1)  # diffusion time for smoothing distances
    turn_weight: float = tuned(0.3, "1", 0, 10)  # of pseudo-scalars of unit deviation against distances of unit scale
    turn_time: float = tuned(1e-3, "area, at unit area", 0, 1)  # diffusion time for smoothing pseudo-scalars
    # Maximum number of landmarks whose pseudo-scalars are used. These distinguish left from right; those of more
    # landmarks would outweigh the distances, and their memory grows quadratically.
    turning: int = tuned(7, "landmarks", 0, 30)
    # Maximum number of landmarks that constrain a map, those farthest from each other. All of them count in the
    # comparison of maps.
    max_count: int = tuned(60, "landmarks", 3, 1000)


LANDMARKS = LandmarkTuning()


@dataclass(frozen=True, eq=False)
class LandmarkFeatures:
    """Some vertices of a shape with their functions."""

    vertices: Integers  # (m,) of the shape's mesh
    distances: Floats  # (n, m) smoothed geodesic distances to them, at unit area
    # (n, t, t) pseudo-scalars of the distances of each two of the first t vertices, all or some, of unit deviation,
    # antisymmetric: the sense in which the two places follow each other around a point, as seen from outside.
    turns: Floats

    def at(self, rows: Integers) -> LandmarkFeatures:
        """The functions at some vertices (q,) only."""
        return LandmarkFeatures(self.vertices, self.distances[rows], self.turns[rows])

    def features(self, chosen: Integers, side: int = 1) -> Floats:
        """(n, d) features of unit scale: distances to the chosen places (c,), and turns of the first of them.

        The side is 1 as seen from outside, -1 as seen from inside; 0 leaves the turns out.
        """
        i, j = _each_two(min(len(chosen), LANDMARKS.turning))
        distances = self.distances[:, chosen]
        scaled = distances / (LANDMARKS.distance_spread * distances.mean(axis=0))
        return np.hstack([scaled, side * LANDMARKS.turn_weight * self.turns[:, chosen[i], chosen[j]]])


@cache
def _each_two(count: int) -> tuple[Integers, Integers]:
    """(p,) the first and (p,) the second of each two of some places."""
    first, second = np.triu_indices(count, k=1)
    return first, second


def landmark_features(shape: ShapeAnalysis, vertices: Integers, turning: int | None = None) -> LandmarkFeatures:
    """The functions of the given vertices (m,) of the shape's mesh, and the turns of the first `turning` of them."""
    graph = edge_graph(shape.mesh.vertices, shape.mesh.triangles)
    distances = np.asarray(dijkstra(graph, indices=vertices)).reshape(len(vertices), -1).T
    distances = shape.basis.smoothed(distances, LANDMARKS.distance_time)
    turning = len(vertices) if turning is None else min(turning, len(vertices))
    i, j = _each_two(turning)
    upper = pseudo_scalars(shape.mesh, shape.basis.areas, distances, i, j)
    upper = shape.basis.smoothed(upper, LANDMARKS.turn_time)
    upper /= np.maximum(upper.std(axis=0), 1e-12)
    turns = np.zeros((len(distances), turning, turning))
    turns[:, i, j], turns[:, j, i] = upper, -upper
    return LandmarkFeatures(np.asarray(vertices), distances, turns)
