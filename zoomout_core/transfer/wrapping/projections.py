# SPDX-License-Identifier: GPL-3.0-or-later
"""Projections of the target's vertices onto the source during wrapping."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.transfer.frames import on_working_mesh
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ProjectionTuning(Tuning, set_by="wrap"):
    """How vertices are projected, and the weights of their projections.

    Attributes:
        normal_weight: the distance that counts as much as a unit difference of normals.
        robust_scale: scale of the weight 1 / (1 + (r / scale)^2)^2 of a projection at distance r (Geman and McClure
            1987).
        max_points: maximum number of source vertices that attract the nearest vertex of the target.
        facing: minimum cosine between normals for moving a vertex all the way to its projection.
    """

    normal_weight: float = tuned(0.03, "at unit area", 0, 10)
    robust_scale: float = tuned(0.1, "at unit area", 1e-6, 10)
    max_points: int = tuned(20_000, "points", 0, 10_000_000)
    facing: float = tuned(0.5, "1", 1e-6, 1)


PROJECTION = ProjectionTuning()


class Projections:
    """Projections of the n vertices of the target's working mesh onto the source; they start at the map's images.

    Positions are at unit area of the source.

    Args:
        mapped: the target on the source.
        given: (n_s,) which vertices of the source have a partner on the target.

    Attributes:
        images: (n, 3) images of the vertices by the map.
        places: (n, 3) their projections.
        triangle: (n,) the source's triangle that contains each projection.
        outwards: (n,) 1 where normals of the source and of the target, rotated by the map, agree, else -1.
    """

    def __init__(self, mapped: MappedTarget, given: Booleans, turned_normals: Floats) -> None:
        working, source, self._surface = mapped.target.working, mapped.source, mapped.whole
        self._unit = float(np.sqrt(source.area))
        self._vertices = source.vertices / self._unit
        self._triangles, self._corners = source.triangles, working.oriented_triangles
        self._normals = source.working.vertex_normals[source.working.vertex_of]
        attracting = np.flatnonzero(given & (source.working.vertex_of >= 0))
        attracting = attracting[:: max(1, -(-len(attracting) // max(1, PROJECTION.max_points)))]
        # Vertices of the source that attract the nearest vertex of the target, and their normals.
        self._attractors = self._vertices[attracting], self._normals[attracting]
        self._flipped = np.zeros(len(source.triangles), dtype=bool)
        self._flipped[source.working.triangle_of[source.working.flipped]] = True
        self.triangle, self._barycentric = (
            on_working_mesh(working, each) for each in (mapped.surface_map.triangle, mapped.surface_map.barycentric)
        )
        self.images = on_working_mesh(working, mapped.points) / self._unit
        self.places = self.images
        agreement = np.einsum("nx,nx->n", turned_normals, self.normals)
        component = np.bincount(working.component, agreement)
        self.outwards = np.where(component < 0, -1.0, 1.0)[working.component]

    def coarsen(self, vertices: Integers, triangles: Integers) -> Projections:
        """Projections of some vertices (c,), with other triangles (m, 3); they share the search of the source."""
        coarse = copy(self)
        coarse._search = self._search
        coarse._corners, coarse.outwards = triangles, self.outwards[vertices]
        coarse.triangle, coarse._barycentric = self.triangle[vertices], self._barycentric[vertices]
        coarse.images, coarse.places = self.images[vertices], self.places[vertices]
        # About one for each vertex: with more, these would outweigh its projection.
        every = max(1, len(self._attractors[0]) // len(vertices))
        coarse._attractors = self._attractors[0][::every], self._attractors[1][::every]
        return coarse

    @property
    def normals(self) -> Floats:
        """(n, 3) unit normals of the source at the projections."""
        return unit_vectors(self._interpolate(self._normals))

    def walk(self, positions: Floats, some: Integers | slice = slice(None)) -> None:
        """Project positions (s, 3) of some vertices (s,) by descent along the source from their last projections."""
        self._place(*self._surface.walk(self.triangle[some], self._unit * positions)[:2], some)

    def jump(self, positions: Floats) -> None:
        """Project positions (n, 3) to the closest points of the source with agreeing normals."""
        self._place(*self._search.closest(positions, self._outward_normals(positions))[:2])

    def goals(self, positions: Floats, image_pull: Floats) -> Floats:
        """(n, 3) goals of vertices at positions (n, 3), whose images have weights (n,).

        A goal is a weighted mean of the vertex's projection, of the source vertices to which it is the nearest, and of
        its image. Weights of projections and source vertices decrease with distance and difference of normals.
        """
        normals = self._outward_normals(positions)
        motion = self.places - positions
        weight = _agreement(motion, normals, self.normals)
        total, count = weight[:, None] * motion, np.ones(len(positions))
        if len(self._attractors[0]):
            rows = [np.hstack([x, PROJECTION.normal_weight * n]) for x, n in ((positions, normals), self._attractors)]
            near = np.asarray(cKDTree(rows[0], balanced_tree=False, compact_nodes=False).query(rows[1])[1])
            motion = self._attractors[0] - positions[near]
            weight = _agreement(motion, normals[near], self._attractors[1])
            total += segment_sum(weight[:, None] * motion, near, len(total))
            count += segment_sum(weight, near, len(total))
        total += image_pull[:, None] * (self.images - positions)
        return np.asarray(positions + total / (count + image_pull)[:, None])

    def with_images(self, image_pull: Floats) -> Floats:
        """(n, 3) means of projections, with weight 1, and images, with weights (n,)."""
        return np.asarray((self.places + image_pull[:, None] * self.images) / (1 + image_pull)[:, None])

    def facing(self, normals: Floats) -> Floats:
        """(n,) share, in [0, 1], of the way to their projections that vertices with outward normals (n, 3) may move."""
        return np.clip(np.einsum("nx,nx->n", normals, self.normals) / PROJECTION.facing, 0, 1)

    def _outward_normals(self, positions: Floats) -> Floats:
        return self.outwards[:, None] * vertex_normals(positions, self._corners)

    @cached_property
    def _search(self) -> OrientedSurface:
        return OrientedSurface(self._vertices, self._triangles, self._flipped, PROJECTION.normal_weight)

    def _place(self, triangle: Integers, barycentric: Floats, some: Integers | slice = slice(None)) -> None:
        places = self.places.copy()
        self.triangle[some], self._barycentric[some] = triangle, barycentric
        places[some] = np.einsum("qc,qcx->qx", barycentric, self._vertices[self._triangles[triangle]])
        self.places = places

    def _interpolate(self, values: Floats) -> Floats:
        return np.asarray(np.einsum("nc,ncx->nx", self._barycentric, values[self._triangles[self.triangle]]))


def _agreement(motion: Floats, normals: Floats, others: Floats) -> Floats:
    """(q,) weights of motions (q, 3) between places with unit normals (q, 3) and (q, 3)."""
    robust = (1 + np.einsum("qx,qx->q", motion, motion) / PROJECTION.robust_scale**2) ** -2
    return np.asarray(robust * np.clip(np.einsum("qx,qx->q", normals, others), 0, 1))
