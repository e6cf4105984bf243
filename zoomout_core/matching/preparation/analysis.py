# SPDX-License-Identifier: GPL-3.0-or-later
"""The analysis of one side of a match: mesh, eigenbasis, samples, and the features that candidates are compared by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.embedded_surface import Neighbourhoods
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.matching.preparation.proxy import Proxy, make_proxy
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import advance, portion
from zoomout_core.runtime.threads import side_by_side
from zoomout_core.spectral.descriptors import mean_curvature, pseudo_scalar_signatures, signature_bands, unit_columns
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.lanczos import eigenpairs
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.spectral.sampling import farthest_points, voronoi_areas
from zoomout_core.tuning import Tuning, tuned

# Pairs of a sample and a vertex whose distances are computed between two progress reports.
VISITS = 100_000
# Mean curvature, at unit area, that is due to rounding, such as on a plane in single precision. It is that of a sphere
# whose radius is a hundred times the square root of the area.
FLAT_CURVATURE = 0.01


@dataclass(frozen=True)
class AnalysisTuning(Tuning, set_by="correspondence"):
    """The features that shapes are compared by."""

    min_functions: int = tuned(120, "eigenfunctions", 2, 1000)  # for ranking, even if the final map is smaller
    search_samples: int = tuned(400, "samples", 1, 10_000)  # farthest-point samples that the search runs on
    distance_samples: int = tuned(200, "samples", 1, 10_000)  # the first of them, with geodesic distances
    # Width w of the Gaussian weight exp(-(d / w)^2) of a sample at distance d: nearer samples of a limb rotate
    # together.
    neighbourhood: float = tuned(0.2, "at unit area", 1e-3, 2)
    neighbours: int = tuned(8, "samples", 1, 100)  # number of nearest samples that count as neighbours
    biharmonic_functions: int = tuned(20, "eigenfunctions", 2, 1000)  # of biharmonic coordinates, the constant included
    # Diffusion times for smoothing mean curvature.
    curvature_times: tuple[float, ...] = tuned((5e-3, 2e-3, 8e-4, 3e-4), "area, at unit area", 0, 1)
    # Limit to which mean curvature is clipped before, so that spikes do not spread.
    curvature_limit: float = tuned(60.0, "1 / length, at unit area", 1, 10_000)
    coarse_functions: int = tuned(61, "eigenfunctions", 3, 1000)  # of signatures for shapes far from isometric
    fine_functions: int = tuned(101, "eigenfunctions", 3, 1000)  # of signatures that a functional map is fitted to
    signature_bands: int = tuned(12, "bands", 3, 100)  # number of energies of the signatures
    pseudo_scalar_time: float = tuned(3e-4, "area, at unit area", 0, 1)  # diffusion time for smoothing pseudo-scalars


ANALYSIS = AnalysisTuning()


@dataclass(frozen=True, eq=False)
class ShapeAnalysis:
    """The analysis of a connected part of a surface."""

    proxy: Proxy  # the part, and its proxy mesh, which everything below belongs to
    stiffness: csc_array  # (n, n) stiffness matrix
    basis: SpectralBasis  # eigenfunctions
    sampled: SampledBasis  # the basis at farthest-point samples
    distances: Floats  # (d, n) geodesic distances, along edges, from the first samples to all vertices, at unit area

    @property
    def mesh(self) -> WorkingMesh:
        """The mesh of unit area that the basis and the samples belong to."""
        return self.proxy.mesh

    @cached_property
    def surface_vertex(self) -> Integers:
        """(n,) for each vertex of the mesh the nearest vertex of the surface."""
        full = self.proxy.full
        used = np.flatnonzero(full.vertex_of >= 0)
        number, first = np.unique(full.vertex_of[used], return_index=True)
        near = cKDTree(full.vertices[number]).query(self.proxy.vertices)[1]
        return used[first[near]]

    @cached_property
    def search(self) -> SampledBasis:
        """The basis at the first samples only, to compare many hypotheses."""
        return SampledBasis.of(self.basis, self.sampled.samples[: ANALYSIS.search_samples])

    @cached_property
    def neighbourhoods(self) -> Neighbourhoods:
        """Neighbourhoods of the mesh's triangles, for precise maps onto them."""
        return Neighbourhoods(self.mesh.triangles, len(self.mesh.vertices))

    @cached_property
    def coordinates(self) -> Floats:
        """(s, d) biharmonic coordinates of the search samples; maps with similar coordinates are the same map."""
        used = slice(1, ANALYSIS.biharmonic_functions)
        return np.asarray(self.search.rows[:, used] / self.basis.eigenvalues[used])

    @cached_property
    def weights(self) -> Floats:
        """(s,) the part of the area that is nearest to each search sample."""
        return voronoi_areas(self.mesh.vertices, self.basis.areas, self.search.samples)

    @cached_property
    def distances_between(self) -> Floats:
        """(d, s) geodesic distances from the first search samples to all of them, in single precision."""
        return self.distances[:, self.search.samples].astype(np.float32)

    @cached_property
    def nearest_distance_sample(self) -> Integers:
        """(s,) for each search sample the nearest distance sample."""
        return np.argmin(self.distances_between, axis=0)

    def min_distances(self, vertices: Integers, others: Integers) -> Floats:
        """(m,) lower bounds of the geodesic distances from vertices (m,) to others (m,), by way of samples near those.

        They are 0 for the same vertices, and too small by at most twice the distance to the nearest sample.
        """
        sample = self.voronoi_cell[vertices]
        return np.maximum(self.distances[sample, others] - self.distances[sample, vertices], 0.0)

    @cached_property
    def surroundings(self) -> tuple[Floats, Booleans]:
        """(d, d) weights of distance samples in each other's surroundings, and (d, d) which are neighbours.

        Weights sum to one in each row; the neighbour relation is symmetric.
        """
        between = self.distances_between[:, : len(self.distances)]
        weights = np.exp(-((between / ANALYSIS.neighbourhood) ** 2))
        near = np.zeros(between.shape, dtype=bool)
        nearest = np.argsort(between, axis=1)[:, 1 : ANALYSIS.neighbours + 1]
        np.put_along_axis(near, nearest, True, axis=1)
        return weights / weights.sum(axis=1, keepdims=True), near | near.T

    @cached_property
    def voronoi_cell(self) -> Integers:
        """(n,) for each vertex the nearest distance sample along the surface."""
        return np.asarray(np.argmin(self.distances, axis=0))

    @cached_property
    def cell_coefficients(self) -> Floats:
        """(k, d) coefficients of the indicators of the distance samples' geodesic Voronoi cells."""
        cell = self.voronoi_cell
        weighted = self.basis.areas[:, None] * self.basis.eigenvectors
        indicator = csc_array(
            (np.ones(len(cell)), (cell, np.arange(len(cell)))), shape=(len(self.distances), len(cell))
        )
        return np.asarray((indicator @ weighted).T)

    @cached_property
    def position_coefficients(self) -> Floats:
        """(k, 3) coefficients of the vertices' positions."""
        return self.basis.coefficients(self.mesh.vertices)

    @cached_property
    def vertex_curvature(self) -> Floats:
        """(n, t) mean curvature on several scales, in (-1, 1), of mean zero; 0 on a plane."""
        limit, times = ANALYSIS.curvature_limit, ANALYSIS.curvature_times
        raw = np.clip(mean_curvature(self.mesh, self.stiffness, self.basis.areas), -limit, limit)
        smooth = np.column_stack([self.basis.smoothed(raw[:, None], time) for time in times])
        size = np.abs(smooth)
        if size.max() < FLAT_CURVATURE:
            return np.zeros_like(smooth)
        squashed = smooth / (size + np.maximum(np.median(size, axis=0), FLAT_CURVATURE))
        return np.asarray(squashed - self.basis.areas @ squashed / self.basis.areas.sum())

    @cached_property
    def curvature(self) -> Floats:
        """(s, t) the same at the search samples."""
        return self.vertex_curvature[self.search.samples]

    @cached_property
    def pseudo_scalars(self) -> Floats:
        """(s, p) pseudo-scalars of pairs of signature bands at the search samples, which tell left from right."""
        bands = signature_bands(self.basis, ANALYSIS.signature_bands, ANALYSIS.coarse_functions)
        pairs = pseudo_scalar_signatures(self.mesh, self.basis.areas, bands)
        return np.asarray(self.basis.smoothed(pairs, ANALYSIS.pseudo_scalar_time)[self.search.samples])

    @cached_property
    def descriptors(self) -> tuple[Floats, Floats]:
        """(k, b) coefficients of signature bands, and (k, p) of their pseudo-scalars, smoothed, of unit norm."""
        bands = signature_bands(self.basis, ANALYSIS.signature_bands, ANALYSIS.fine_functions)
        pairs = self.basis.coefficients(pseudo_scalar_signatures(self.mesh, self.basis.areas, bands))
        pairs *= np.exp(-ANALYSIS.pseudo_scalar_time * self.basis.eigenvalues)[:, None]
        return self.basis.coefficients(bands), unit_columns(pairs, np.linalg.norm(pairs, axis=0))


def analyse(part: WorkingMesh, k: int, samples: int, seed: int, proxy_vertices: int | None = None) -> ShapeAnalysis:
    """Prepare a connected working mesh of unit area, decimated to about `proxy_vertices` first, if these are given.

    It has k eigenfunctions, or fewer on a mesh of fewer vertices, and at least k farthest-point samples.

    Raises:
        MeshError: there is not enough memory for its number of vertices.
    """
    with portion(0.0, 0.3):
        proxy = make_proxy(part, proxy_vertices)
    mesh = proxy.mesh
    advance(0.3)
    stiffness, areas = mesh_laplacian(mesh.vertices, mesh.triangles)
    k = min(k, len(areas) - 1)
    chosen = farthest_points(mesh.vertices, max(samples, k))
    try:
        with portion(0.3, 0.95):
            pairs, distances = side_by_side(
                partial(eigenpairs, stiffness, areas, k, seed),
                partial(_distances, mesh, chosen[: ANALYSIS.distance_samples]),
            )
    except MemoryError:
        raise MeshError(
            "There is not enough memory to analyze a mesh of {count:,} vertices: match a smaller "
            "proxy, by a coarser detail or a lower proxy_vertices.",
            count=len(areas),
        ) from None
    basis = SpectralBasis(*pairs, areas, mesh.vertices)
    return ShapeAnalysis(proxy, stiffness, basis, SampledBasis.of(basis, chosen), distances)


def _distances(mesh: WorkingMesh, samples: Integers) -> Floats:
    """(d, n) geodesic distances from samples to all vertices."""
    graph = edge_graph(mesh.vertices, mesh.triangles)
    found: list[Floats] = []
    # `dijkstra` holds the interpreter lock, so it runs in short pieces.
    pieces = min(len(samples), 8 + len(samples) * len(mesh.vertices) // VISITS)
    for few in np.array_split(samples, pieces):
        advance(len(found) / pieces)
        found.append(dijkstra(graph, indices=few))
    return np.concatenate(found)
