# SPDX-License-Identifier: GPL-3.0-or-later
"""Correspondences of non-rigid ICP: closest points with compatible normals, both ways, and their residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.embedded_surface import EmbeddedSurface
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.refinement.local_rigid_alignment import RIGID_ALIGNMENT
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.runtime.once import once_per_argument

# Scale s of the weight 1 / (1 + (r / s)^2)^2 of a residual r, at unit area (Geman and McClure 1987), and the smallest
# weight of a correspondence.
ROBUST_SCALE = 0.03
MIN_WEIGHT = 1e-3
# Query points on each shape for each node of the deformation graph, and their largest number.
QUERY_POINTS_PER_NODE = 10
MAX_QUERY_POINTS = 1000
# Largest geodesic distance on the source, at unit area, from a correspondence to the image under the first map.
MAX_GEODESIC_DISTANCE = 0.12
# Samples whose geodesic distances bound that distance from below, by the triangle inequality.
BOUND_SAMPLES = 40


@dataclass(frozen=True, eq=False)
class QueryPoints:
    """Samples of a shape that are projected onto the other one."""

    vertex: Integers  # (p,) their numbers
    areas: Floats  # (p,) the area of the surface that each represents

    @classmethod
    def on(cls, shape: ShapeAnalysis, nodes: int) -> QueryPoints:
        """Points for a deformation graph of some number of nodes."""
        known, count = _query_points(shape), min(QUERY_POINTS_PER_NODE * nodes, MAX_QUERY_POINTS)
        if count not in known:
            samples = shape.sampled.samples[:count]
            owner = np.asarray(cKDTree(shape.mesh.vertices[samples]).query(shape.mesh.vertices)[1])
            areas = shape.basis.areas
            known[count] = cls(samples, segment_sum(areas, owner, len(samples)) / areas.sum())
        return known[count]


@once_per_argument
def _query_points(_shape: ShapeAnalysis) -> dict[int, QueryPoints]:
    """The query points of a shape that are known, by their number: levels and both directions use the same ones."""
    return {}


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The source, prepared for closest points with compatible normals."""

    source: ShapeAnalysis
    places: Floats  # (n_s, 6) its vertices and scaled normals
    tree: cKDTree  # k-d tree of these
    surface: EmbeddedSurface  # its triangles

    @staticmethod
    @once_per_argument
    def of(source: ShapeAnalysis) -> Surroundings:
        """Prepare an undeformed shape."""
        return Surroundings.deform(source, source.mesh.vertices, source.mesh.vertex_normals)

    @classmethod
    def deform(cls, source: ShapeAnalysis, positions: Floats, normals: Floats) -> Surroundings:
        """Prepare a shape with other vertex positions (n, 3) and unit normals (n, 3)."""
        places = _with_normals(positions, normals)
        return cls(source, places, cKDTree(places), EmbeddedSurface(positions, source.neighbourhoods))

    def closest(self, positions: Floats, normals: Floats) -> SurfaceMap:
        """The points closest to places (q, 3), near vertices with normals compatible with those given (q, 3)."""
        near = np.asarray(self.tree.query(_with_normals(positions, normals))[1])
        return SurfaceMap(*self.surface.closest(positions, near), self.source.mesh.triangles)


class GeodesicLimit:
    """Rejects correspondences that are too far from the first map's images in geodesic distance on the source.

    The first map sends the target's vertices to vertices `first` (n_t,) of the source. Correspondences on vertices
    `is_cut` (n_s,) next to a missing part are rejected, too, because they may belong to this part.
    """

    def __init__(self, first: Integers, source: ShapeAnalysis, is_cut: Booleans | None = None) -> None:
        self._first, self._is_cut = first, is_cut
        self._marks = source.distances[:BOUND_SAMPLES].T.astype(np.float32)

    def exceeds_geodesic_limit(self, vertex: Integers, partner: Integers) -> Booleans:
        """(q,) whether pairs of a target vertex and a source vertex are too far from the first map's images."""
        apart = np.abs(self._marks[partner] - self._marks[self._first[vertex]]).max(axis=1)
        beyond = np.asarray(apart > MAX_GEODESIC_DISTANCE)
        return beyond if self._is_cut is None else beyond | self._is_cut[partner]


def residuals(
    positions: Floats,  # (n, 3) of the target's vertices
    normals: Floats,  # (n, 3) of these
    here: QueryPoints,  # query points of the target
    there: QueryPoints,  # query points of the source
    around: Surroundings,
    limit: GeodesicLimit,  # on geodesic distances from the first map
    sliding: float,  # see `Level`
    robust_scale: float = ROBUST_SCALE,  # see `Level`
    min_weight: float = MIN_WEIGHT,  # see `Level`
) -> tuple[Integers, Floats, Floats]:
    """Residuals of closest points in both directions, for `DeformationGraph.step`.

    Returns (q,) vertices of the target, (q, 3) residuals and (q, 3, 3) roots of weights.
    """
    mesh = around.source.mesh
    found = around.closest(positions[here.vertex], normals[here.vertex])
    back = there.vertex
    if len(back):  # a whole is not projected to its part
        back = np.asarray(cKDTree(_with_normals(positions, normals)).query(around.places[back])[1])
    vertex = np.concatenate([here.vertex, back])
    partner = np.concatenate([found.interpolate(mesh.vertices), mesh.vertices[there.vertex]])
    partner_normal = np.concatenate([found.interpolate(mesh.vertex_normals), mesh.vertex_normals[there.vertex]])
    partner_normal = unit_vectors(partner_normal)
    beyond = limit.exceeds_geodesic_limit(vertex, np.concatenate([found.vertex, there.vertex]))
    residual = partner - positions[vertex]
    agreement = np.einsum("qx,qx->q", normals[vertex], partner_normal)
    trust = np.clip(agreement, 0, 1) / (1 + (np.linalg.norm(residual, axis=1) / robust_scale) ** 2) ** 2
    trust = np.where(beyond, min_weight, np.maximum(trust, min_weight))
    across = partner_normal[:, :, None] * partner_normal[:, None]
    weight = np.sqrt(sliding) * np.eye(3) + (np.sqrt(1 + sliding) - np.sqrt(sliding)) * across
    return vertex, residual, np.sqrt(np.concatenate([here.areas, there.areas]) * trust)[:, None, None] * weight


def _with_normals(positions: Floats, normals: Floats) -> Floats:
    return np.hstack([positions, RIGID_ALIGNMENT.normal_weight * normals])
