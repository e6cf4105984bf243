# SPDX-License-Identifier: GPL-3.0-or-later
"""The target, mapped onto the source: the places of its vertices, corners and faces there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.shapes import place_unused
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths, triangle_areas
from zoomout_core.transfer.attribute import Domain, mean_over_vertices
from zoomout_core.transfer.cut_mesh import (
    CutSurface,
    adjacent_edges,
    cut_surface,
    face_edges,
    nearer_than,
    triangles_of_faces,
)
from zoomout_core.transfer.inpaint import Filling, filling

# Centres of the four parts of a triangle that is divided at the midpoints of its edges.
SAMPLES = np.array([[2, 2, 2], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
# Added to the area of samples, relative to the mean area of triangles, so that degenerate triangles vote as well.
MIN_AREA = 1e-9
# Fraction of the way to the centre of its triangle by which a corner is moved, to find its side of a source edge.
NUDGE = 0.25
# Added to the confidence that weights samples, so that those without confidence vote as well.
CONFIDENCE_OFFSET = 1e-3


@dataclass(frozen=True, eq=False)
class FaceSamples:
    """Points distributed evenly over faces of the target, and their places on the source; ordered by face."""

    face: Integers  # (q,) the target's face of each
    triangle: Integers  # (q,) the source's triangle that contains each
    barycentric: Floats  # (q, 3) the point in it
    area: Floats  # (q,) the area that each represents
    weight: Floats  # (q,) the area, weighted by confidence


@dataclass(frozen=True, eq=False)
class MappedTarget:
    """The target mapped over the source; vertices without a usable position are placed, see `place_unused`."""

    source: Surface  # the surface with the data
    target: Surface  # the surface that receives it
    surface_map: SurfaceMap  # the place of each target vertex on the source
    confidence: Floats  # (n_t,) confidence of the map, in [0, 1]
    fill_below: float | None = None  # vertices of less confidence are filled in from the others; None for none
    has_partner: Booleans | None = None  # (n_t,) which have a partner, others are filled in; None for all

    def __post_init__(self) -> None:
        for name in ("source", "target"):
            object.__setattr__(self, name, place_unused(getattr(self, name)))

    @cached_property
    def points(self) -> Floats:
        """(n_t, 3) positions of the target's vertices on the source."""
        return self.surface_map.interpolate(self.source.vertices)

    @cached_property
    def whole(self) -> CutSurface:
        """The source without any cut."""
        return cut_surface(self.source, np.zeros((len(self.source.corner_vertex), 1)))

    @cached_property
    def adjacent(self) -> tuple[Integers, Integers]:
        """Where faces of the target meet, see `adjacent_edges`."""
        return adjacent_edges(self.target)

    @cached_property
    def circumference(self) -> Floats:
        """(f_t,) perimeter of each face of the target."""
        length = edge_lengths(self.target.vertices[self.target.corner_vertex], face_edges(self.target))
        return np.asarray(np.bincount(self.target.corner_face, length), dtype=np.float64)

    @cached_property
    def balls(self) -> tuple[Floats, Floats]:
        """(f_t, 3) centres and (f_t,) radii of balls around the corners of each face of the target, on the source."""
        middle = mean_over_vertices(self.points, Domain.FACE, self.target)
        off = self.points[self.target.corner_vertex] - middle[self.target.corner_face]
        return middle, np.sqrt(np.maximum.reduceat(np.einsum("cx,cx->c", off, off), self.target.face_start[:-1]))

    @cached_property
    def filling(self) -> Filling | None:
        """The filling of vertices of too little confidence, or None if there are none."""
        trusted = self.confidence >= (0 if self.fill_below is None else self.fill_below)
        if self.has_partner is not None:
            trusted &= self.has_partner
        return None if trusted.all() else filling(self.target, trusted)

    def locate(self, triangle: Integers, barycentric: Floats) -> tuple[Integers, Floats]:
        """Locate points (q, 3) of the target's triangles (q,) on the source: the images of the corners, mixed in space.

        Unlike `SurfaceMap.at`, this walks along the surface from the image of the nearest corner. It does not pass
        through thin walls, and does not search the whole source. Returns triangles and barycentric coordinates of the
        source.
        """
        corners = self.target.triangles[triangle]
        nearest = corners[np.arange(len(corners)), np.argmax(barycentric, axis=1)]
        points = np.einsum("qc,qcx->qx", barycentric, self.points[corners])
        found, weights, _ = self.whole.walk(self.surface_map.triangle[nearest], points)
        return found, weights

    def samples(self, faces: Integers) -> FaceSamples:
        """Four samples for each triangle of some faces (f,), in ascending order."""
        target = self.target
        number, triangle = triangles_of_faces(target, faces)
        area = triangle_areas(target.vertices, target.triangles[triangle]) / len(SAMPLES)
        area += MIN_AREA * target.area / len(target.triangles)
        face, triangle, area = (np.repeat(each, len(SAMPLES)) for each in (faces[number], triangle, area))
        barycentric = np.tile(SAMPLES, (len(face) // len(SAMPLES), 1))
        confidence = np.einsum("qc,qc->q", barycentric, self.confidence[target.triangles[triangle]])
        return FaceSamples(face, *self.locate(triangle, barycentric), area, area * (confidence + CONFIDENCE_OFFSET))

    def nudge(self, corners: Integers) -> tuple[Integers, Floats]:
        """Locate corners (q,) of the target, moved slightly into their faces, on the source."""
        target = self.target
        largest = np.argsort(triangle_areas(target.vertices, target.triangles), kind="stable")
        in_triangle = np.empty(len(target.corner_vertex), dtype=np.int64)
        in_triangle[target.triangle_corners[largest].ravel()] = np.repeat(largest, 3)
        triangle = in_triangle[corners]
        here = target.triangle_corners[triangle] == corners[:, None]
        return self.locate(triangle, np.where(here, 1 - NUDGE, 0) + NUDGE / 3)

    def near_border(self, cut: CutSurface) -> Booleans:
        """(f_t,) whether a face of the target might cross a cut of the source."""
        border = self.source.vertices[self.source.corner_vertex[cut.border]]
        island = cut.triangle_island[self.surface_map.triangle][self.target.corner_vertex]
        begin = self.target.face_start[:-1]
        torn = np.minimum.reduceat(island, begin) < np.maximum.reduceat(island, begin)
        return torn | nearer_than(*self.balls, border[:, 0], border[:, 1])
