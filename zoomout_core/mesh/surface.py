# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces and point clouds, validated once on creation.

A `Surface` keeps the user's mesh unchanged: vertices, polygons, corners. Geometry is computed on its `working` copy, in
which coincident borders are welded, degenerate faces are removed, the winding is consistent and the total area is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Booleans, Floats, Integers, fill_masked, to_array
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.reconstruction import triangulate_points
from zoomout_core.mesh.triangles import triangle_areas, unit_vectors, vertex_areas
from zoomout_core.mesh.triangulation import triangulate
from zoomout_core.mesh.working_mesh import WorkingMesh, working_mesh
from zoomout_core.runtime.summary import Summary

# Larger coordinates overflow when areas are squared.
LARGEST_COORDINATE = 1e75
# Areas of meshes of a smaller extent vanish when they are squared.
SMALLEST_EXTENT = 1e-75
# A vertex this many times as far away as the median vertex cannot share faces with the others: compared with these
# faces, all others would vanish in rounding. The second number is how many face corners the median is taken of.
FARTHEST, MANY = 1e6, 10_000


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
        corner_vertex, face_start = _corners(faces)
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
        corners, starts = _whole_numbers(corner_vertex), _whole_numbers(face_start)
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
        self.vertices: Floats = _check_points(vertices)
        _check_faces(self.vertices, corner_vertex, face_start)
        self.corner_vertex = corner_vertex
        self.face_start = face_start
        self.triangle_corners: Integers = (
            triangulate(self.vertices, corner_vertex, face_start)
            if triangle_corners is None
            else _check_triangles(triangle_corners, len(corner_vertex))
        )
        self._edges = None if edges is None else _check_edges(edges, len(self.vertices))
        if not self.area > 0:
            extent = np.ptp(self.vertices[corner_vertex], axis=0).max()
            if 0 < extent < SMALLEST_EXTENT:
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


class PointCloud:
    """Points sampled from a surface, with normals if they are known.

    Args:
        points: (n, 3) positions.
        normals: (n, 3) outward normals, or None.

    Raises:
        MeshError: fewer than 12 points, coordinates that are not finite, or not one normal per point.

    Example:
        >>> zo.match(source, zo.PointCloud(target.vertices), k_final=30).surface_map.triangle.shape == truth.shape
        True
    """

    def __init__(self, points: ArrayLike, normals: ArrayLike | None = None) -> None:
        self.points = _check_points(points)
        self.normals = None if normals is None else _check_points(normals)
        if not measurable(self.points).all():
            raise MeshError("Some points have coordinates that are not finite or far too large: remove them.")
        if self.normals is not None and not (len(self.normals) == len(self.points) and np.isfinite(self.normals).all()):
            raise MeshError(
                f"Each of the {len(self.points)} points needs a finite normal: correct the normals, or omit them."
            )
        if len(self.points) < 12:
            raise MeshError(f"A point cloud of {len(self.points)} points is too small: at least 12 are needed.")

    @cached_property
    def surface(self) -> Surface:
        """The surface reconstructed from the points; these are its vertices, in the same order.

        Raises:
            MeshError: no surface passes through the points.
        """
        triangles = triangulate_points(self.points, None if self.normals is None else unit_vectors(self.normals))
        if not len(triangles):
            raise MeshError(
                "No surface passes through the points: check that they are not all on a line or at one point."
            )
        return Surface(self.points, triangles)


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


# --- checks of the user's arrays ------------------------------------------------------------------------------


def vertex_numbers(numbers: ArrayLike, count: int, what: str, element: str = "vertex") -> Integers:
    """Check a user's numbers (m,) of vertices, or triangles, from 0 to below a count; integral floats are accepted.

    Raises:
        ValueError: `what` they are begins the message, which names the first invalid one.
    """
    array = to_array(numbers, what)
    if array.ndim != 1 or array.dtype.kind not in "iuf":
        raise ValueError(
            f"{what} must be a list of {element} numbers from 0 to {count - 1}, not {array.dtype} of shape "
            f"{array.shape}."
        )
    wrong = array[~((array >= 0) & (array < count) & (array == np.floor(array)))]  # also finds NaN
    if len(wrong):
        raise ValueError(f"{what} must be {element} numbers from 0 to {count - 1}, but {wrong[0]} is not.")
    return array.astype(np.int64)


def _check_points(points: ArrayLike) -> Floats:
    try:
        if isinstance(points, np.ndarray) and points.dtype.kind in "cmM":  # complex numbers, durations and dates
            raise TypeError
        array = np.array(fill_masked(points), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise MeshError("Positions must be numbers, three for each vertex.") from None
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"Positions must be an array of shape (n, 3), not {array.shape}.")
    return array


def _corners(faces: ArrayLike | Sequence[Sequence[int]]) -> tuple[Integers, Integers]:
    """Flat corners and face starts of an array of faces or a list of polygons."""
    if isinstance(faces, np.ndarray) and faces.ndim == 2:
        return _whole_numbers(faces.ravel()), np.arange(len(faces) + 1) * faces.shape[1]
    try:
        polygons: list[Any] = list(cast(Sequence[Any], faces))
        sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    except TypeError:
        raise MeshError("Faces must be an array of shape (f, k), or a sequence of polygons.") from None
    try:
        corners = np.asarray([vertex for polygon in polygons for vertex in polygon])
    except (TypeError, ValueError):  # some are sequences themselves
        corners = np.zeros((0, 0))
    if corners.ndim != 1:
        raise MeshError("Faces must be an array of shape (f, k), or a sequence of polygons of vertex numbers.")
    return _whole_numbers(corners), np.concatenate([[0], np.cumsum(sizes)])


def _whole_numbers(numbers: ArrayLike) -> Integers:
    """Numbers of elements as integers; integral floats, as some files and programs have, are accepted."""
    try:
        array = np.asarray(fill_masked(numbers))
    except ValueError:  # rows of different lengths
        array = np.full(1, np.nan)
    whole = array.dtype.kind in "iu" or (
        array.dtype.kind == "f" and bool((np.abs(array) < 2**53).all() and (array == np.trunc(array)).all())
    )
    if array.size and not whole:
        raise MeshError("Faces and edges must refer to vertices by whole numbers, counted from 0.")
    return array.astype(np.int64)


def _check_triangles(triangle_corners: ArrayLike, corner_count: int) -> Integers:
    triangles = _whole_numbers(triangle_corners)
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        raise MeshError(f"A triangulation must be an array of shape (m, 3), not {triangles.shape}: correct it.")
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < corner_count):
        raise MeshError(f"The triangulation names corner {triangles.max()}, but there are {corner_count}: correct it.")
    return triangles


def _check_edges(edges: ArrayLike, vertex_count: int) -> Integers:
    array = _whole_numbers(edges)
    if array.ndim != 2 or array.shape[1] != 2:
        raise MeshError(f"Edges must be an array of shape (e, 2), not {array.shape}.")
    if array.size and not (array.min() >= 0 and array.max() < vertex_count):
        wrong = array[(array < 0) | (array >= vertex_count)][0]
        raise MeshError(f"An edge refers to vertex {wrong}, but the mesh has {vertex_count} vertices, numbered from 0.")
    return array


def _edges_of_faces(corner_vertex: Integers, face_start: Integers) -> Integers:
    following = np.roll(corner_vertex, -1)
    following[face_start[1:] - 1] = corner_vertex[face_start[:-1]]
    count = int(corner_vertex.max()) + 1
    keys = np.unique(np.minimum(corner_vertex, following) * count + np.maximum(corner_vertex, following))
    return np.stack(np.divmod(keys, count), axis=1)


def _check_faces(vertices: Floats, corner_vertex: Integers, face_start: Integers) -> None:
    if len(face_start) < 2:
        raise MeshError("The mesh has no faces: a surface is needed, not only points or edges.")
    sizes = np.diff(face_start)
    if sizes.min() < 3:
        face = int(np.argmin(sizes))
        raise MeshError(f"Face {face} has {sizes[face]} corners: remove faces with fewer than three.")
    if face_start[0] != 0 or face_start[-1] != len(corner_vertex):
        raise MeshError(
            f"face_start goes from {face_start[0]} to {face_start[-1]} for {len(corner_vertex)} corners: the first "
            "entry must be 0, and the last the number of corners."
        )
    if corner_vertex.min() < 0 or corner_vertex.max() >= len(vertices):
        wrong = int(np.flatnonzero((corner_vertex < 0) | (corner_vertex >= len(vertices)))[0])
        raise MeshError(
            f"A face refers to vertex {corner_vertex[wrong]}, but the mesh has {len(vertices)} vertices, numbered "
            "from 0."
        )
    usable = measurable(vertices)
    if not usable.all() and len(broken := np.unique(corner_vertex[~usable[corner_vertex]])):
        raise MeshError(
            "{count:,} vertices have coordinates that are not finite or far too large (the first is "
            "vertex {vertex}): remove or repair them.",
            count=len(broken),
            vertex=broken[0],
        )
    _check_distances(vertices, corner_vertex, face_start)


def _check_distances(vertices: Floats, corner_vertex: Integers, face_start: Integers) -> None:
    """Reject faces between vertices that are close together and vertices that are extremely far away."""
    some = vertices[corner_vertex[:: 1 + len(corner_vertex) // MANY]]
    middle = np.median(some, axis=0)
    farthest = FARTHEST * np.median(np.linalg.norm(some - middle, axis=1))
    if farthest == 0 or np.abs(vertices - middle).max() <= farthest:
        return
    far = np.linalg.norm(vertices[corner_vertex] - middle, axis=1) > farthest
    sizes = np.diff(face_start)
    partly = np.add.reduceat(far, face_start[:-1], dtype=np.int64) < sizes
    astray = np.unique(corner_vertex[far & np.repeat(partly, sizes)])
    if len(astray):
        raise MeshError(
            "Vertex {vertex} is used by faces but more than {times:,.0f} times as far away as the "
            "other vertices: move it back, or remove it.",
            vertex=astray[0],
            times=FARTHEST,
        )


def measurable(points: Floats) -> Booleans:
    """(n,) which points (n, 3) have coordinates that are finite and at most `LARGEST_COORDINATE`."""
    return np.asarray((np.abs(points) <= LARGEST_COORDINATE).all(axis=1))  # false for NaN
