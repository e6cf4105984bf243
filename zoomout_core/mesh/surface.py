# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces, validated once on creation.

A `Surface` keeps the user's mesh unchanged: vertices, polygons, corners. Geometry is computed on its `working` copy, in
which coincident borders are welded, degenerate faces are removed, the winding is consistent and the total area is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import (
    check_edges,
    check_faces,
    check_points,
    check_triangles,
    flatten_faces,
    whole_numbers,
)
from zoomout_core.mesh.triangles import triangle_areas, vertex_areas
from zoomout_core.mesh.triangulation import triangulate
from zoomout_core.mesh.working_mesh import WorkingMesh, working_mesh
from zoomout_core.runtime.summary import Summary

# The area of a mesh of a smaller extent vanishes when it is squared.
MIN_EXTENT = 1e-75


class Surface(Summary):
    """A polygon mesh.

    Args:
        vertices: (n, 3) positions, in any unit.
        faces: (f, k) vertex numbers, or a sequence of polygons of any size.
        edges: (e, 2) vertex numbers, if a program numbers the edges; those of the faces when not given.

    Attributes:
        vertices: (n, 3) positions.
        corner_vertex: (c,) the vertex of each face corner, face after face.
        face_start: (f + 1,) the first corner of each face, and the number of corners.
        triangle_corners: (m, 3) the corners that each triangle of the triangulation connects.

    Raises:
        MeshError: there are no faces or no area; vertex numbers are fractional or out of range; or coordinates are not
            finite, or so far from zero that the faces vanish in rounding.

    Example:
        >>> square = zo.Surface([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]])
        >>> square.area
        1.0
    """

    def __init__(
        self, vertices: ArrayLike, faces: ArrayLike | Sequence[Sequence[int]], edges: ArrayLike | None = None
    ) -> None:
        corner_vertex, face_start = flatten_faces(faces)
        self._set(vertices, corner_vertex, face_start, None, edges)

    @classmethod
    def from_corners(
        cls,
        vertices: ArrayLike,
        corner_vertex: ArrayLike,
        face_start: ArrayLike,
        triangle_corners: ArrayLike | None = None,
        edges: ArrayLike | None = None,
    ) -> Surface:
        """Make a surface from flat corner arrays, as programs store them, not a Python list of faces.

        Args:
            vertices: (n, 3) positions.
            corner_vertex: (c,) the vertex of each corner.
            face_start: (f + 1,) first corner of each face; the last entry is c.
            triangle_corners: (m, 3) a triangulation by corner numbers; computed when not given.
            edges: (e, 2) vertex numbers of the edges, including loose ones; those of the faces when not given.

        Raises:
            MeshError: as for the constructor, or the arrays are inconsistent.
        """
        surface = cls.__new__(cls)
        corners, starts = whole_numbers(corner_vertex), whole_numbers(face_start)
        if corners.ndim != 1 or starts.ndim != 1:
            raise MeshError("Corners and starts of faces must be lists of numbers, one face after the other.")
        surface._set(vertices, corners, starts, triangle_corners, edges)
        return surface

    @classmethod
    def joined(cls, surfaces: Sequence[Surface]) -> Surface:
        """Join several surfaces: their vertices, corners, faces, triangles and edges follow each other.

        Raises:
            TypeError: there are none, or they are not surfaces.
        """
        if not surfaces or not all(isinstance(surface, Surface) for surface in surfaces):
            raise TypeError("Give at least one surface, in a list.")
        vertex, corner = (
            np.cumsum([0, *(len(getattr(surface, name)) for surface in surfaces[:-1])])
            for name in ("vertices", "corner_vertex")
        )
        shifted = list(zip(surfaces, vertex, corner, strict=True))
        return cls.from_corners(
            np.concatenate([surface.vertices for surface in surfaces]),
            np.concatenate([surface.corner_vertex + first for surface, first, _ in shifted]),
            np.concatenate([[0], *(surface.face_start[1:] + first for surface, _, first in shifted)]),
            np.concatenate([surface.triangle_corners + first for surface, _, first in shifted]),
            np.concatenate([surface.edges + first for surface, first, _ in shifted]),
        )

    def with_vertices(self, vertices: ArrayLike) -> Surface:
        """The same faces, triangles and edges on other positions (n, 3).

        Raises:
            MeshError: coordinates that are not finite, or no area.
        """
        return Surface.from_corners(vertices, self.corner_vertex, self.face_start, self.triangle_corners, self._edges)

    def subset(self, kept: Booleans) -> Surface:
        """The vertices that are kept (n,), with the triangles between them.

        Raises:
            MeshError: no triangle is left.
        """
        number = np.cumsum(kept) - 1
        return Surface(self.vertices[kept], number[self.triangles[kept[self.triangles].all(axis=1)]])

    def _set(
        self,
        vertices: ArrayLike,
        corner_vertex: Integers,
        face_start: Integers,
        triangle_corners: ArrayLike | None,
        edges: ArrayLike | None,
    ) -> None:
        self._working: WorkingMesh | None = None
        self._rounding: float | None = None
        self.vertices: Floats = check_points(vertices)
        check_faces(self.vertices, corner_vertex, face_start)
        self.corner_vertex = corner_vertex
        self.face_start = face_start
        self.triangle_corners: Integers = (
            triangulate(self.vertices, corner_vertex, face_start)
            if triangle_corners is None
            else check_triangles(triangle_corners, len(corner_vertex))
        )
        self._edges = None if edges is None else check_edges(edges, len(self.vertices))
        if not self.area > 0:
            extent = np.ptp(self.vertices[corner_vertex], axis=0).max()
            if 0 < extent < MIN_EXTENT:
                raise MeshError("The mesh has an extent of only {extent:.0e}: scale it up.", extent=extent)
            raise MeshError("The mesh has no area because all of its faces are degenerate: repair them.")
        self._check_rounding()

    def _check_rounding(self) -> None:
        """Reject coordinates whose rounding is larger than an edge, because nothing is left of the shape."""
        if self.rounding_of_edges > 1:
            raise MeshError(
                "The mesh is so far from its origin that its coordinates are rounded by more than an edge length: move "
                "it to the origin in the program that created it."
            )

    @cached_property
    def triangles(self) -> Integers:
        """(m, 3) vertex numbers of the triangulation."""
        return self.corner_vertex[self.triangle_corners]

    @cached_property
    def corner_face(self) -> Integers:
        """(c,) the face that each corner belongs to."""
        return np.repeat(np.arange(len(self.face_start) - 1), np.diff(self.face_start))

    @cached_property
    def triangle_face(self) -> Integers:
        """(m,) the face that each triangle belongs to."""
        return self.corner_face[self.triangle_corners[:, 0]]

    @property
    def edges(self) -> Integers:
        """(e, 2) vertex numbers of the edges: as given, else each edge of the faces once, the smaller number first."""
        if self._edges is None:
            self._edges = _edges_of_faces(self.corner_vertex, self.face_start)
        return self._edges

    @cached_property
    def area(self) -> float:
        """Total area, in squared units of the vertices."""
        return float(triangle_areas(self.vertices, self.triangles).sum())

    @cached_property
    def vertex_areas(self) -> Floats:
        """(n,) a third of the areas of the triangles at each vertex, in squared units of the vertices."""
        return vertex_areas(self.vertices, self.triangles)

    def share_of_area(self, chosen: Booleans) -> float:
        """The share of the area, in [0, 1], that belongs to some of the vertices (n,)."""
        return float(self.vertex_areas[chosen].sum() / self.vertex_areas.sum())

    @property
    def working(self) -> WorkingMesh:
        """The welded copy of unit area that bases and maps are computed on."""
        # Not a cached_property: up to Python 3.11 it blocks other threads that compute that of another surface.
        if self._working is None:
            self._working = working_mesh(self.vertices, self.triangles, self.area, self.corner_vertex)
        return self._working

    @working.setter
    def working(self, mesh: WorkingMesh) -> None:
        """Reuse the working mesh of a surface with the same arrays."""
        self._working = mesh

    @property
    def rounding(self) -> float:
        """The step that the coordinates were rounded to, in units of the vertices.

        It grows with the distance from zero, and is that of double precision if a coordinate needs it.
        """
        if self._rounding is None:
            used = self.vertices[self.corner_vertex]
            self._rounding = single_precision_step(used) or float(np.spacing(np.abs(used).max()))
        return self._rounding

    @rounding.setter
    def rounding(self, step: float) -> None:
        """Set the step of the coordinates before they were transformed.

        Raises:
            MeshError: it is larger than an edge.
        """
        self._rounding = step
        self._check_rounding()

    @property
    def rounding_of_edges(self) -> float:
        """`rounding` in lengths of a typical edge, which is the leg of a right triangle of mean area."""
        return self.rounding / float(np.sqrt(2 * self.area / len(self.triangle_corners)))

    def _summary(self) -> dict[str, str]:
        low, high = self.vertices[self.corner_vertex].min(axis=0), self.vertices[self.corner_vertex].max(axis=0)
        return {
            "vertices": f"{len(self.vertices):,}",
            "faces": f"{len(self.face_start) - 1:,}",
            "extent": " x ".join(f"{length:.4g}" for length in high - low),
            "area": f"{self.area:.4g}",
        }

    @property
    def components(self) -> Integers:
        """(n,) connected component of each vertex, largest area first; -1 for a vertex without a face."""
        working = self.working
        return np.where(working.vertex_of >= 0, working.component[working.vertex_of], -1)


def single_precision_step(positions: ArrayLike) -> float:
    """The largest distance from a coordinate (n, 3) to the next number of single precision.

    It is 0 unless all coordinates are such numbers.
    """
    points = np.asarray(positions)
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = points.astype(np.float32)
        if not len(points) or (rounded != points).any():
            return 0.0
        return float(np.spacing(np.abs(rounded).max()))


def _edges_of_faces(corner_vertex: Integers, face_start: Integers) -> Integers:
    """(e, 2) vertex numbers of each edge of the faces once, the smaller number first."""
    following = np.roll(corner_vertex, -1)
    following[face_start[1:] - 1] = corner_vertex[face_start[:-1]]
    count = int(corner_vertex.max()) + 1
    keys = np.unique(np.minimum(corner_vertex, following) * count + np.maximum(corner_vertex, following))
    return np.stack(np.divmod(keys, count), axis=1)
