# SPDX-License-Identifier: GPL-3.0-or-later
"""Reversible harmonic maps (RHM).

Ezuz, Solomon and Ben-Chen, Reversible harmonic maps between discrete surfaces (2019). Both shapes are embedded so that
Euclidean distances approximate geodesic ones (X_1, X_2, n x d). The maps in both directions (P_12, P_21: a point of the
other surface for each vertex) and their images Y_12, Y_21 in these embeddings minimise, summed over both
directions,

    alpha tr(Y_12' W_1 Y_12) + (1 - alpha) ||P_21 Y_12 - X_2||^2 + beta ||Y_12 - P_12 X_2||^2:

the Dirichlet energy of the map, its deviation from invertibility, and the distance of the image from the other
surface; norms are weighted by area. Given the maps, Y solves a sparse linear system; given Y, every vertex is projected
onto the other surface in the joint embedding of both terms with P_12, [sqrt(1 - alpha) Y_21, sqrt(beta) X_2].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.embedded_surface import Neighbourhoods, project_to_embedding
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.spectral.sampling import farthest_points

# Dimension of the embedding, as in the paper, and number of places that distances are computed from.
DIMENSION, PLACES = 8, 200
# Weight of the Dirichlet energy; beta grows from the first value to the second, relative to the other terms.
ALPHA = 3e-4
BETA = 0.01, 5.0
ITERATIONS = 30


@dataclass(frozen=True, eq=False)
class Embedded:
    """A connected surface without unused vertices.

    Attributes:
        surface: the mesh.
        positions: (n, d) whose Euclidean distances approximate geodesic ones, at unit area.
        stiffness: (n, n) of the Laplacian.
        areas: (n,) of the vertices, summing to one.
        around: neighbourhoods of triangles, for projections.
    """

    surface: Surface
    positions: Floats
    stiffness: csc_array
    areas: Floats
    around: Neighbourhoods

    @classmethod
    def of(cls, surface: Surface) -> Embedded:
        """The surface with its embedding, Laplacian and search structure."""
        n = len(surface.vertices)
        laplacian = mesh_laplacian(surface.vertices, surface.triangles)
        return cls(surface, geodesic_embedding(surface), *laplacian, Neighbourhoods(surface.triangles, n))

    def matrix(self, onto: SurfaceMap) -> csr_array:
        """(q, n) matrix of a map onto this surface: barycentric coordinates of the images."""
        rows = np.repeat(np.arange(len(onto.triangle)), 3)
        columns = onto.source_triangles[onto.triangle].ravel()
        return csr_array((onto.barycentric.ravel(), (rows, columns)), shape=(len(onto.triangle), len(self.areas)))


def rhm(
    source: Surface, target: Surface, initial: Integers, initial_back: Integers, iterations: int = ITERATIONS
) -> tuple[Integers, Integers]:
    """Refine two vertex maps, one in each direction, together.

    Args:
        source: the surface that the map lands on.
        target: the surface that the map starts from.
        initial: (n_t,) source vertex of each target vertex.
        initial_back: (n_s,) target vertex of each source vertex.
        iterations: how often; at least one.

    Returns:
        (n_t,) the nearest source vertex of each target vertex's image, and (n_s,) the same of the map back.
    """
    of_source, of_target = Embedded.of(source), Embedded.of(target)
    there = SurfaceMap.from_vertices(initial, source)
    back = SurfaceMap.from_vertices(initial_back, target)
    for beta in np.geomspace(*BETA, iterations):
        P, Q = of_source.matrix(there), of_target.matrix(back)
        image = images(of_target, of_source, P, Q, beta)
        image_back = images(of_source, of_target, Q, P, beta)
        there = _project(of_target, of_source, image, image_back, beta)
        back = _project(of_source, of_target, image_back, image, beta)
    return there.vertex, back.vertex


def images(start: Embedded, end: Embedded, there: csr_array, back: csr_array, beta: float) -> Floats:
    """(n_1, d) the optimal images in the other surface's embedding, given the maps in both directions.

    Args:
        start: the surface to be mapped (1).
        end: the surface with the images (2).
        there: (n_1, n_2) matrix of the map.
        back: (n_2, n_1) matrix of the map back.
        beta: weight of the distance from the other surface.
    """
    returned = (1 - ALPHA) * back.T @ diags_array(end.areas)
    near = beta * diags_array(start.areas)
    system = ALPHA * start.stiffness + near + returned @ back
    return np.asarray(factorise(csc_array(system)).solve(near @ (there @ end.positions) + returned @ end.positions))


def geodesic_embedding(surface: Surface, dimension: int = DIMENSION) -> Floats:
    """(n, dimension) positions whose Euclidean distances approximate geodesic ones, at unit area.

    Classical scaling of the distances between farthest points, to which all other vertices are added (landmark MDS,
    de Silva and Tenenbaum 2004). Distances run along edges.
    """
    places = farthest_points(surface.vertices, PLACES)
    graph = edge_graph(surface.vertices, surface.triangles)
    squared = (dijkstra(graph, indices=places) / np.sqrt(surface.area)) ** 2
    mean = squared[:, places].mean(axis=0)
    centred = squared[:, places] - mean[:, None] - mean + mean.mean()
    values, vectors = np.linalg.eigh(-centred / 2)
    largest = np.argsort(-values)[:dimension]
    return np.asarray((mean[:, None] - squared).T / 2 @ (vectors[:, largest] / np.sqrt(values[largest])))


def _project(start: Embedded, end: Embedded, image: Floats, image_back: Floats, beta: float) -> SurfaceMap:
    """The map that minimises both terms in which it occurs."""
    weights = np.sqrt(1 - ALPHA), np.sqrt(beta)
    queries = np.hstack([weights[0] * start.positions, weights[1] * image])
    surface = np.hstack([weights[0] * image_back, weights[1] * end.positions])
    found = project_to_embedding(queries, surface, end.around, nearest(queries, surface))
    return SurfaceMap(*found, end.surface.triangles)
