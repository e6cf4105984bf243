# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures of a shape that may lack pieces: absolute lengths, and distances to the nearest cut.

No measure is relative to the whole, because cuts change the area, mean distances and spectra. Both shapes of a pair
have the same unit. A measure is used only if no cut can have changed it. A geodesic distance is valid if every path
through a cut is longer, and the area around a place is valid up to the nearest cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.triangles import border_edges, edge_graph
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class IncompleteShapeTuning(Tuning, set_by="partial"):
    """The comparison of shapes with missing pieces; lengths are those of the larger shape at unit area."""

    loop: float = tuned(0.05, "length", 0, 10)  # a piece may be missing at longer borders; eyes of scans are shorter
    # Total length of these borders, relative to the square root of the shape's area, above which a large piece may be
    # missing. Eyes and mouths of cats have at most 0.16, cuts at least 0.85.
    fragment: float = tuned(0.4, "1", 0, 100)
    # Radii of the balls whose areas are compared.
    radii: tuple[float, ...] = tuned(tuple(np.geomspace(0.04, 0.8, 20).round(4).tolist()), "length", 1e-3, 10)


INCOMPLETE = IncompleteShapeTuning()


def at_scale(shape: ShapeAnalysis, scale: float) -> ShapeAnalysis:
    """A shape with all of its lengths multiplied by a factor."""
    if scale == 1:
        return shape
    full = _scale(shape.proxy.full, scale)
    mesh = full if shape.proxy.mesh is shape.proxy.full else _scale(shape.proxy.mesh, scale)
    proxy = replace(shape.proxy, full=full, mesh=mesh, vertices=shape.proxy.vertices * scale)
    basis = replace(shape.basis.at_area(scale**2), points=mesh.vertices)
    sampled = SampledBasis.of(basis, shape.sampled.samples)
    return ShapeAnalysis(proxy, shape.stiffness, basis, sampled, shape.distances * scale)


def _scale(mesh: WorkingMesh, scale: float) -> WorkingMesh:
    return replace(mesh, vertices=mesh.vertices * scale, scale=mesh.scale / scale)


@dataclass(frozen=True, eq=False)
class IncompleteShape:
    """A shape that may lack pieces; its places are the distance samples."""

    shape: ShapeAnalysis  # the shape, in a common unit with the one that it is compared with

    @cached_property
    def between(self) -> Floats:
        """(d, d) geodesic distances between the places."""
        distances = self.shape.distances[:, self.shape.search.samples[: len(self.shape.distances)]]
        return (distances + distances.T) / 2

    @cached_property
    def _cuts(self) -> tuple[Integers, float]:
        """The vertices of borders at which a piece may be missing, and the length of these borders."""
        mesh = self.shape.mesh
        border = border_edges(mesh.triangles)
        n = len(mesh.vertices)
        graph = coo_array((np.ones(len(border), dtype=bool), border.T), shape=(n, n))
        loop = connected_components(graph, directed=False)[1][border[:, 0]]
        length = np.linalg.norm(mesh.vertices[border[:, 0]] - mesh.vertices[border[:, 1]], axis=1)
        is_cut = segment_sum(length, loop, n)[loop] > INCOMPLETE.loop
        return np.unique(border[is_cut]), float(length[is_cut].sum())

    @cached_property
    def cut_distance_of_vertices(self) -> Floats:
        """(n,) geodesic distance to the nearest border at which a piece may be missing; infinite without one."""
        mesh, cuts = self.shape.mesh, self._cuts[0]
        if not len(cuts):
            return np.full(len(mesh.vertices), np.inf)
        return np.asarray(dijkstra(edge_graph(mesh.vertices, mesh.triangles), indices=cuts, min_only=True))

    @cached_property
    def cut_distance(self) -> Floats:
        """(d,) the same at the places."""
        return self.cut_distance_of_vertices[self.shape.search.samples[: len(self.shape.distances)]]

    @cached_property
    def is_fragment(self) -> bool:
        """Whether its cuts are long enough for a missing torso or leg, not only for a hand or the eyes."""
        return self._cuts[1] > INCOMPLETE.fragment * np.sqrt(self.shape.basis.areas.sum())

    @cached_property
    def unaffected(self) -> Booleans:
        """(d, d) whether the distance between two places is valid, because the path past any cut is longer."""
        return self.between <= self.cut_distance[:, None] + self.cut_distance

    @cached_property
    def log_ball_areas(self) -> Floats:
        """(d, r) logarithms of the areas within the radii around each place."""
        count, rings = len(self.shape.distances), len(INCOMPLETE.radii) + 1
        ring = np.searchsorted(INCOMPLETE.radii, self.shape.distances) + rings * np.arange(count)[:, None]
        areas = np.bincount(ring.ravel(), np.tile(self.shape.basis.areas, count), rings * count)
        balls = np.cumsum(areas.reshape(count, rings)[:, :-1], axis=1)
        return np.asarray(np.log(np.maximum(balls, 1e-9)))

    @cached_property
    def areas(self) -> Floats:
        """(d,) the area that is nearest to each place."""
        return segment_sum(self.shape.basis.areas, self.shape.voronoi_cell, len(self.between))


def unlikeness(of_target: IncompleteShape, of_source: IncompleteShape) -> Floats:
    """(d_t, d_s) dissimilarity of the surroundings of two places, in [0, 1].

    The mean difference of the logarithms of the areas within each radius, at most 1. If a cut reaches one of the balls,
    its area is a lower bound, so that only an excess counts. If cuts reach both, the difference is unknown.
    """
    radii = np.array(INCOMPLETE.radii)
    is_cut, is_cut_there = (radii > shape.cut_distance[:, None] for shape in (of_target, of_source))
    areas, areas_there = (shape.log_ball_areas.astype(np.float32) for shape in (of_target, of_source))
    # The excess of an infinite area is zero.
    bounds, bounds_there = np.where(is_cut, np.inf, areas), np.where(is_cut_there, np.inf, areas_there)
    total = np.zeros((len(areas), len(areas_there)), dtype=np.float32)
    for r in range(len(radii)):
        excess = np.maximum(areas[:, None, r] - bounds_there[:, r], areas_there[:, r] - bounds[:, None, r])
        total += np.clip(excess, 0, 1, out=excess)
    known = len(radii) - is_cut.astype(np.float32) @ is_cut_there.T.astype(np.float32)
    return np.asarray(total / np.maximum(known, 1), dtype=np.float64)
