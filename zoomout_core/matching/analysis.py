"""One side of a match, prepared: the mesh, its basis, samples, and what candidates are compared by."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import Neighbourhoods
from zoomout_core.maps.zoomout import SampledBasis
from zoomout_core.matching.proxy import Proxy, proxy_steps
from zoomout_core.mesh.surface import MeshError
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.stepping import scaled
from zoomout_core.runtime.threads import side_by_side
from zoomout_core.spectral.descriptors import mean_curvature, pseudo_scalar_signatures, signature_bands, unit_columns
from zoomout_core.spectral.eigenbasis import SpectralBasis, eigenpairs_steps
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.spectral.sampling import farthest_points, voronoi_areas

# The search for the right map runs on this many samples; distances are known from the first of them.
SEARCH_SAMPLES = 400
DISTANCE_SAMPLES = 200
# Distances to so many vertices, from all samples together, are worked out at once.
VISITS = 100_000
# Two samples of a limb turn alike when they are nearer than this, at unit area; so many of them are neighbours.
NEIGHBOURHOOD, NEIGHBOURS = 0.2, 8
# Mean curvature is looked at on these scales (diffusion times at unit area), after cutting off its spikes.
CURVATURE_TIMES = (5e-3, 2e-3, 8e-4, 3e-4)
CURVATURE_LIMIT = 60.0
# The curvature of a sphere whose radius is a hundred times the square root of the area: single precision makes as
# much of a plane.
FLAT_CURVATURE = 0.01
# Signatures are made of so many eigenfunctions: few where shapes are compared, which need not be isometric, more
# where a map is fitted to them.
COARSE_FUNCTIONS, FINE_FUNCTIONS = 61, 101
SIGNATURE_BANDS = 12
PSEUDO_SCALAR_TIME = 3e-4


@dataclass(frozen=True, eq=False)
class ShapeAnalysis:
    """A connected part of a surface with everything that matching needs of it.

    Attributes:
        proxy: the part, and the mesh that stands in for it in all that follows.
        stiffness: (n, n) stiffness matrix.
        basis: eigenfunctions.
        sampled: the basis at farthest-point samples.
        distances: (d, n) geodesic distances, along edges, from the first samples to all vertices, at unit area.
    """

    proxy: Proxy
    stiffness: csc_array
    basis: SpectralBasis
    sampled: SampledBasis
    distances: Floats

    @property
    def mesh(self) -> WorkingMesh:
        """The mesh of unit area that the basis and the samples belong to."""
        return self.proxy.mesh

    @cached_property
    def search(self) -> SampledBasis:
        """The basis at the first samples only, for trying many hypotheses."""
        return SampledBasis.of(self.basis, self.sampled.samples[:SEARCH_SAMPLES])

    @cached_property
    def neighbourhoods(self) -> Neighbourhoods:
        """Of the mesh's triangles, for precise maps onto them."""
        return Neighbourhoods(self.mesh.triangles, len(self.mesh.vertices))

    @cached_property
    def coordinates(self) -> Floats:
        """(s, 19) biharmonic coordinates of the search samples: maps with like images are the same map."""
        return np.asarray(self.search.rows[:, 1:20] / self.basis.eigenvalues[1:20])

    @cached_property
    def weights(self) -> Floats:
        """(s,) the part of the area that each search sample stands for."""
        return voronoi_areas(self.mesh.vertices, self.basis.areas, self.search.samples)

    @cached_property
    def distances_between(self) -> Floats:
        """(d, s) geodesic distances from the first search samples to all of them, in single precision."""
        return self.distances[:, self.search.samples].astype(np.float32)

    @cached_property
    def nearest_distance_sample(self) -> Integers:
        """(s,) for each search sample the nearest one of those that distances are known from."""
        return np.argmin(self.distances_between, axis=0)

    @cached_property
    def surroundings(self) -> tuple[Floats, Booleans]:
        """(d, d) what each sample that distances are known from weighs in another's surroundings, and which are near.

        Weights sum to one in each row; nearness is mutual.
        """
        between = self.distances_between[:, : len(self.distances)]
        weights = np.exp(-((between / NEIGHBOURHOOD) ** 2))
        near = np.zeros(between.shape, dtype=bool)
        np.put_along_axis(near, np.argsort(between, axis=1)[:, 1 : NEIGHBOURS + 1], True, axis=1)
        return weights / weights.sum(axis=1, keepdims=True), near | near.T

    @cached_property
    def cell_coefficients(self) -> Floats:
        """(k, d) coefficients of the indicators of the geodesic Voronoi cells that distances are known from."""
        cell = np.argmin(self.distances, axis=0)
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
    def curvature(self) -> Floats:
        """(s, 4) mean curvature at the search samples on several scales, squashed, of mean zero; 0 on a plane."""
        raw = np.clip(mean_curvature(self.mesh, self.stiffness, self.basis.areas), -CURVATURE_LIMIT, CURVATURE_LIMIT)
        smooth = np.column_stack([self.basis.smoothed(raw[:, None], time) for time in CURVATURE_TIMES])
        size = np.abs(smooth)
        if size.max() < FLAT_CURVATURE:
            return np.zeros((len(self.search.samples), len(CURVATURE_TIMES)))
        squashed = smooth / (size + np.maximum(np.median(size, axis=0), FLAT_CURVATURE))
        centred = squashed - self.basis.areas @ squashed
        return np.asarray(centred[self.search.samples])

    @cached_property
    def pseudo_scalars(self) -> Floats:
        """(s, 55) pseudo-scalars of pairs of signature bands at the search samples: they tell left from right."""
        bands = signature_bands(self.basis, SIGNATURE_BANDS, COARSE_FUNCTIONS)
        pairs = pseudo_scalar_signatures(self.mesh, self.basis.areas, bands)
        return np.asarray(self.basis.smoothed(pairs, PSEUDO_SCALAR_TIME)[self.search.samples])

    @cached_property
    def descriptors(self) -> tuple[Floats, Floats]:
        """(k, 12) coefficients of signature bands, and (k, 55) of their pseudo-scalars, smoothed, of unit norm."""
        bands = signature_bands(self.basis, SIGNATURE_BANDS, FINE_FUNCTIONS)
        pairs = self.basis.coefficients(pseudo_scalar_signatures(self.mesh, self.basis.areas, bands))
        pairs *= np.exp(-PSEUDO_SCALAR_TIME * self.basis.eigenvalues)[:, None]
        return self.basis.coefficients(bands), unit_columns(pairs, np.linalg.norm(pairs, axis=0))


def analysis_steps(
    part: WorkingMesh, k: int, samples: int, seed: int, proxy_vertices: int | None = None
) -> Generator[float, None, ShapeAnalysis]:
    """Prepare a connected working mesh, yielding the fraction done.

    Args:
        part: one component, of unit area.
        k: number of eigenfunctions; fewer when the mesh has not as many vertices.
        samples: number of farthest-point samples, at least k of them are taken.
        seed: of the eigensolver.
        proxy_vertices: decimate the part to about this many vertices first; None to keep them all.

    Raises:
        MeshError: there is not enough memory for so many vertices.
    """
    yield 0.0
    proxy = yield from scaled(proxy_steps(part, proxy_vertices), 0.0, 0.3)
    mesh = proxy.mesh
    yield 0.3
    stiffness, areas = mesh_laplacian(mesh.vertices, mesh.triangles)
    k = min(k, len(areas) - 1)
    chosen = farthest_points(mesh.vertices, max(samples, k))
    eigenpairs = eigenpairs_steps(stiffness, areas, k, seed)
    both = side_by_side(eigenpairs, _distance_steps(mesh, chosen[:DISTANCE_SAMPLES]))
    try:
        pairs, distances = yield from scaled(both, 0.3, 0.95)
    except MemoryError:
        raise MeshError(
            f"There is not enough memory to analyse a mesh of {len(areas)} vertices: match it by a smaller stand-in, "
            "as proxy_vertices or a coarser detail says."
        ) from None
    basis = SpectralBasis(*pairs, areas, mesh.vertices)
    return ShapeAnalysis(proxy, stiffness, basis, SampledBasis.of(basis, chosen), distances)


def _distance_steps(mesh: WorkingMesh, samples: Integers) -> Generator[float, None, Floats]:
    """(d, n) geodesic distances from samples to all vertices, yielding the fraction done."""
    graph = edge_graph(mesh.vertices, mesh.triangles)
    found: list[Floats] = []
    # dijkstra keeps the interpreter to itself, so not for long at a time.
    pieces = min(len(samples), 8 + len(samples) * len(mesh.vertices) // VISITS)
    for few in np.array_split(samples, pieces):
        yield len(found) / pieces
        found.append(dijkstra(graph, indices=few))
    return np.concatenate(found)
