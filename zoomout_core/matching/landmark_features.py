"""Functions that a few places on a shape define: the distances to them, and the sense in which they turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.spectral.descriptors import pseudo_scalars

# Spread of a distance over a shape, as a part of its mean: brings distances to unit scale.
DISTANCE_SPREAD = 0.3
DISTANCE_TIME = 5e-4
TURN_WEIGHT = 0.3
TURN_TIME = 1e-3
# So many places tell left from right; more would only outweigh the distances, and fill the memory.
TURNING = 7


@dataclass(frozen=True, eq=False)
class LandmarkFeatures:
    """Some vertices of a shape with their functions.

    Attributes:
        vertices: (m,) of the shape's mesh.
        distances: (n, m) smoothed geodesic distances to them, at unit area.
        turns: (n, m, m) pseudo-scalars of the distances of each two, of unit deviation, antisymmetric: the
            sense in which the two places lie around a point, as seen from outside.
    """

    vertices: Integers
    distances: Floats
    turns: Floats

    def at(self, rows: Integers) -> LandmarkFeatures:
        """The functions at some vertices (q,) only."""
        return LandmarkFeatures(self.vertices, self.distances[rows], self.turns[rows])

    def features(self, chosen: Integers, side: int = 1) -> Floats:
        """(n, d) features of unit scale: distances to the chosen places (c,), and turns of the first of them.

        Args:
            chosen: numbers of places, in an order.
            side: 1 as seen from outside, -1 as seen from inside; 0 leaves the turns out.
        """
        i, j = np.triu_indices(min(len(chosen), TURNING), k=1)
        distances = self.distances[:, chosen] / (DISTANCE_SPREAD * self.distances[:, chosen].mean(axis=0))
        return np.hstack([distances, side * TURN_WEIGHT * self.turns[:, chosen[i], chosen[j]]])


def landmark_features(shape: ShapeAnalysis, vertices: Integers) -> LandmarkFeatures:
    """The functions of the given vertices (m,) of the shape's mesh."""
    graph = edge_graph(shape.mesh.vertices, shape.mesh.triangles)
    distances = np.asarray(dijkstra(graph, indices=vertices)).reshape(len(vertices), -1).T
    distances = shape.basis.smoothed(distances, DISTANCE_TIME)
    i, j = np.triu_indices(len(vertices), k=1)
    upper = pseudo_scalars(shape.mesh, shape.basis.areas, distances[:, i], distances[:, j])
    upper = shape.basis.smoothed(upper, TURN_TIME)
    upper /= np.maximum(upper.std(axis=0), 1e-12)
    turns = np.zeros((len(distances), len(vertices), len(vertices)))
    turns[:, i, j], turns[:, j, i] = upper, -upper
    return LandmarkFeatures(np.asarray(vertices), distances, turns)
