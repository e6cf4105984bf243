"""Surfaces and point clouds, checked once at the edge so that the rest may trust them.

A `Surface` keeps the user's mesh as it is: vertices, polygons, corners. Geometry is worked out on its
`working` copy, where borders that coincide are welded, faces without an extent are left out, the winding is
made consistent and the total area is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.csgraph import connected_components

# What an array holds, for the reader: numpy's own types differ too much from version to version to be checked.
Floats: TypeAlias = NDArray[Any]
Integers: TypeAlias = NDArray[Any]
Booleans: TypeAlias = NDArray[Any]

# Borders closer than this part of the bounding box are the same border: exporters split vertices at UV seams.
WELD_TOLERANCE = 2.0**-20
# Larger coordinates overflow where areas are squared.
LARGEST_COORDINATE = 1e75
# A signed volume below this part of a sphere's of the same area says nothing about inside and outside.
FLAT_VOLUME = 0.02
# The same for a closed surface, whose volume is exact up to rounding.
NO_VOLUME = 1e-9
# An open surface may bend the other way in another pose unless its volume, relative to a sphere's, exceeds the
# length of its mean normal so many times.
SHALLOW = 2.0


class MeshError(ValueError):
    """A mesh that cannot be used; the message says in one sentence what is wrong and what to do."""


@dataclass(frozen=True, eq=False)
class WorkingMesh:
    """The welded, consistently wound triangle mesh of unit area that geometry is computed on.

    Attributes:
        vertices: (n, 3) positions, centred, divided by the square root of the surface's area.
        triangles: (m, 3) vertex numbers, corners in the order of the surface's own triangle.
        flipped: (m,) whether a triangle winds against the consistent, outward orientation.
        vertex_of: (n_surface,) the working vertex of each vertex of the surface, -1 where no face uses it.
        triangle_of: (m,) the surface's triangle that each triangle stems from.
        component: (n,) number of the connected component of each vertex, the largest area first.
        scale: square root of the surface's area, in the surface's units.
    """

    vertices: Floats
    triangles: Integers
    flipped: Booleans
    vertex_of: Integers
    triangle_of: Integers
    component: Integers
    scale: float

    @cached_property
    def oriented_triangles(self) -> Integers:
        """(m, 3) the triangles, all wound so that their normals point outwards."""
        oriented = self.triangles.copy()
        oriented[self.flipped, 1], oriented[self.flipped, 2] = (
            self.triangles[self.flipped, 2],
            self.triangles[self.flipped, 1],
        )
        return oriented

    @cached_property
    def vertex_normals(self) -> Floats:
        """(n, 3) outward unit normals, weighted by area."""
        return vertex_normals(self.vertices, self.oriented_triangles)

    @cached_property
    def sides_are_known(self) -> bool:
        """Whether the volume that it encloses tells outside from inside: not of a cloth, which may bend either way.

        The mean normal is zero where a surface is closed, and of unit length where it is flat.
        """
        corners = self.vertices[self.oriented_triangles]
        area, volume = _area_and_volume(corners, np.zeros(len(corners), dtype=int))
        mean_normal = np.linalg.norm(_area_normals(self.vertices, self.oriented_triangles).sum(axis=0)) / 2 / area[0]
        return bool(volume[0] / _sphere(area[0]) > SHALLOW * mean_normal + NO_VOLUME)

    def part(self, component: int) -> tuple[WorkingMesh, Integers]:
        """One connected component as a mesh of its own, rescaled to unit area.

        Returns:
            The component, and (n_part,) the vertices of this mesh that it consists of.
        """
        inside = self.component == component
        vertices = np.flatnonzero(inside)
        if len(vertices) == len(inside):
            return self, vertices
        number = np.full(len(inside) + 1, -1)  # the extra last entry answers for vertex_of = -1
        number[vertices] = np.arange(len(vertices))
        kept = inside[self.triangles[:, 0]]
        triangles = number[self.triangles[kept]]
        area = triangle_areas(self.vertices[vertices], triangles).sum()
        points = self.vertices[vertices] - self.vertices[vertices].mean(axis=0)
        return WorkingMesh(
            vertices=points / np.sqrt(area),
            triangles=triangles,
            flipped=self.flipped[kept],
            vertex_of=number[self.vertex_of],
            triangle_of=self.triangle_of[kept],
            component=np.zeros(len(vertices), dtype=int),
            scale=self.scale * float(np.sqrt(area)),
        ), vertices


class Surface:
    """A polygon mesh.

    Args:
        vertices: (n, 3) positions, in any unit.
        faces: (f, k) vertex numbers, or a sequence of polygons of any size.
        edges: (e, 2) vertex numbers, where a program numbers the edges; those of the faces when not given.

    Attributes:
        vertices: (n, 3) positions.
        corner_vertex: (c,) the vertex of each face corner, face after face.
        face_start: (f + 1,) the first corner of each face, and the number of corners.
        triangle_corners: (m, 3) the corners that each triangle of the triangulation connects.

    Raises:
        MeshError: no faces, numbers that are not whole or out of range, coordinates that are not finite, or no area.
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
        """A surface from flat corner arrays, as programs store them (no Python list of faces).

        Args:
            vertices: (n, 3) positions.
            corner_vertex: (c,) the vertex of each corner.
            face_start: (f + 1,) first corner of each face; the last entry is c.
            triangle_corners: (m, 3) a triangulation by corner numbers; worked out when not given.
            edges: (e, 2) vertex numbers of the edges, loose ones too; those of the faces when not given.

        Raises:
            MeshError: as for the constructor, or the arrays do not fit each other.
        """
        surface = cls.__new__(cls)
        surface._set(
            vertices,
            _whole_numbers(corner_vertex),
            _whole_numbers(face_start),
            triangle_corners,
            edges,
        )
        return surface

    def with_vertices(self, vertices: ArrayLike) -> Surface:
        """The same faces and triangles on other positions (n, 3).

        Raises:
            MeshError: coordinates that are not finite, or no area.
        """
        return Surface.from_corners(vertices, self.corner_vertex, self.face_start, self.triangle_corners)

    def _set(
        self,
        vertices: ArrayLike,
        corner_vertex: Integers,
        face_start: Integers,
        triangle_corners: ArrayLike | None,
        edges: ArrayLike | None,
    ) -> None:
        self._working: WorkingMesh | None = None
        self.vertices: Floats = _checked_points(vertices)
        _check_faces(self.vertices, corner_vertex, face_start)
        self.corner_vertex = corner_vertex
        self.face_start = face_start
        self.triangle_corners: Integers = (
            _triangulate(self.vertices, corner_vertex, face_start)
            if triangle_corners is None
            else _checked_triangles(triangle_corners, len(corner_vertex))
        )
        self._edges = None if edges is None else _checked_edges(edges, len(self.vertices))
        if not self.area > 0:
            raise MeshError("The mesh has no area: all of its faces are degenerate; give it faces with an extent.")

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
        """(m,) the face that each triangle is a part of."""
        return self.corner_face[self.triangle_corners[:, 0]]

    @property
    def edges(self) -> Integers:
        """(e, 2) vertex numbers of the edges: as given, else each of the faces' once, the smaller number first."""
        if self._edges is None:
            self._edges = _edges_of_faces(self.corner_vertex, self.face_start)
        return self._edges

    @cached_property
    def area(self) -> float:
        """Total area, in squared units of the vertices."""
        return float(triangle_areas(self.vertices, self.triangles).sum())

    @property
    def working(self) -> WorkingMesh:
        """The welded copy of unit area that bases and maps are computed on."""
        # Up to Python 3.11 a cached_property lets no other surface's be computed in another thread meanwhile.
        if self._working is None:
            self._working = _working_mesh(self)
        return self._working

    @working.setter
    def working(self, mesh: WorkingMesh) -> None:
        """Take over the working mesh of a surface of the same arrays."""
        self._working = mesh

    @property
    def components(self) -> Integers:
        """(n,) connected component of each vertex, largest area first; -1 where no face uses the vertex."""
        working = self.working
        return np.where(working.vertex_of >= 0, working.component[working.vertex_of], -1)


class PointCloud:
    """Points sampled from a surface, with normals if they are known.

    Args:
        points: (n, 3) positions.
        normals: (n, 3) unit normals, or None.

    Raises:
        MeshError: fewer than 12 points, coordinates that are not finite, or not a normal for each point.
    """

    def __init__(self, points: ArrayLike, normals: ArrayLike | None = None) -> None:
        self.points = _checked_points(points)
        self.normals = None if normals is None else _checked_points(normals)
        if not np.isfinite(self.points).all():
            raise MeshError("Some points have coordinates that are not finite: remove them.")
        if self.normals is not None and not (len(self.normals) == len(self.points) and np.isfinite(self.normals).all()):
            raise MeshError(f"{len(self.points)} points need as many finite normals: correct them, or leave them out.")
        if len(self.points) < 12:
            raise MeshError(f"A point cloud of {len(self.points)} points is too small: at least 12 are needed.")


def triangle_areas(vertices: Floats, triangles: Integers) -> Floats:
    """(m,) areas of the triangles (m, 3) on the points (n, 3)."""
    return 0.5 * np.linalg.norm(_area_normals(vertices, triangles), axis=1)


def triangle_normals(vertices: Floats, triangles: Integers) -> Floats:
    """(m, 3) unit normals of the triangles (m, 3) on the points (n, 3); zero for a degenerate one."""
    return unit_vectors(_area_normals(vertices, triangles))


def vertex_normals(vertices: Floats, triangles: Integers) -> Floats:
    """(n, 3) unit normals of the vertices, the triangles' averaged by area; zero where there are none."""
    weighted = _area_normals(vertices, triangles)
    normals = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(weighted[:, axis], 3), minlength=len(vertices)) for axis in range(3)],
        axis=1,
    )
    return unit_vectors(normals)


def unit_vectors(vectors: Floats) -> Floats:
    """Vectors (m, 3) of unit length, or zeros where they have none."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def unique_edges(triangles: Integers) -> tuple[Integers, Integers]:
    """The undirected edges of triangles (m, 3).

    Returns:
        (e, 2) vertex numbers, the smaller first, and (m, 3) the edge from each corner to the next.
    """
    side, first = _sides_by_edge(triangles)
    edge_of = np.empty(triangles.size, dtype=np.int64)
    edge_of[side] = np.repeat(np.arange(len(first) - 1), np.diff(first))
    low, high = _ends(triangles)
    chosen = side[first[:-1]]
    return np.stack([low[chosen], high[chosen]], axis=1), edge_of.reshape(-1, 3)


def _ends(triangles: Integers) -> tuple[Integers, Integers]:
    """(3m,) the smaller and the larger vertex of each side of triangles (m, 3), from a corner to the next."""
    following = np.roll(triangles, -1, axis=1)
    return np.minimum(triangles, following).ravel(), np.maximum(triangles, following).ravel()


class _Sides(NamedTuple):
    """The sides of triangles, one undirected edge after the other.

    Attributes:
        side: (3m,) numbers of the sides, 3 t for that from the first corner of triangle t to the second.
        first: (e + 1,) where each edge's sides begin among them.
    """

    side: Integers
    first: Integers


def _sides_by_edge(triangles: Integers) -> _Sides:
    """The sides of triangles (m, 3) by the vertices that they connect.

    They are counted into the rows of a sparse matrix, which takes a third of the time that sorting them does.
    """
    low, high = _ends(triangles)
    n = int(high.max(initial=-1)) + 1
    one_each = np.ones(len(low), dtype=np.int8), low, np.arange(len(low) + 1)
    by_low = csc_array(one_each, shape=(n, len(low))).tocsr()
    table = csr_array((by_low.indices, high[by_low.indices], by_low.indptr), shape=(n, n))
    table.sort_indices()
    side = table.data
    begins = np.ones(len(side), dtype=bool)
    begins[1:] = (np.diff(table.indices) != 0) | (np.diff(low[side]) != 0)
    return _Sides(side, np.append(np.flatnonzero(begins), len(side)))


def edge_graph(vertices: Floats, triangles: Integers) -> csr_array:
    """(n, n) graph of a triangle mesh's edges, weighted by their lengths; symmetric, as good as undirected."""
    edges, _ = unique_edges(triangles)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    return csr_array((np.concatenate([length, length]), (rows, columns)), shape=(len(vertices), len(vertices)))


def _area_normals(vertices: Floats, triangles: Integers) -> Floats:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return _cross(b - a, c - a)


def _cross(u: Floats, v: Floats) -> Floats:
    """(m, 3) cross products of vectors (m, 3): several times as fast as numpy's."""
    return np.stack([u[:, i - 2] * v[:, i - 1] - u[:, i - 1] * v[:, i - 2] for i in range(3)], axis=1)


# --- the edge: what a user hands in -------------------------------------------------------------------------


def _checked_points(points: ArrayLike) -> Floats:
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError):
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
    corners = [vertex for polygon in polygons for vertex in polygon]
    return _whole_numbers(corners), np.concatenate([[0], np.cumsum(sizes)])


def _whole_numbers(numbers: ArrayLike) -> Integers:
    """Numbers of elements as integers; whole floats, as some files and programs give them, will do."""
    array = np.asarray(numbers)
    whole = array.dtype.kind in "iu" or (
        array.dtype.kind == "f" and bool((np.abs(array) < 2**53).all() and (array == np.trunc(array)).all())
    )
    if array.size and not whole:
        raise MeshError("Faces and edges must name their vertices by whole numbers, counted from 0.")
    return array.astype(np.int64)


def _checked_triangles(triangle_corners: ArrayLike, corner_count: int) -> Integers:
    triangles = _whole_numbers(triangle_corners).reshape(-1, 3)
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < corner_count):
        raise MeshError(f"The triangulation names corner {triangles.max()}, but there are {corner_count}: correct it.")
    return triangles


def _checked_edges(edges: ArrayLike, vertex_count: int) -> Integers:
    array = _whole_numbers(edges)
    if array.ndim != 2 or array.shape[1] != 2:
        raise MeshError(f"Edges must be an array of shape (e, 2), not {array.shape}.")
    if array.size and not (array.min() >= 0 and array.max() < vertex_count):
        wrong = array[(array < 0) | (array >= vertex_count)][0]
        raise MeshError(f"An edge names vertex {wrong}, but the mesh has {vertex_count} vertices, numbered from 0.")
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
            f"Faces that take up the corners {face_start[0]} to {face_start[-1]} were given {len(corner_vertex)} "
            "corners: the first face must start at 0, and the last entry be their number."
        )
    if corner_vertex.min() < 0 or corner_vertex.max() >= len(vertices):
        wrong = int(np.flatnonzero((corner_vertex < 0) | (corner_vertex >= len(vertices)))[0])
        raise MeshError(
            f"A face names vertex {corner_vertex[wrong]}, but the mesh has {len(vertices)} vertices, numbered from 0."
        )
    usable = (np.abs(vertices) <= LARGEST_COORDINATE).all(axis=1)  # and so no NaN
    broken = np.unique(corner_vertex[~usable[corner_vertex]])
    if len(broken):
        raise MeshError(
            f"{len(broken)} vertices have coordinates that are not finite or beyond all measure "
            f"(the first is vertex {broken[0]}): remove or repair them."
        )


# --- triangulation ------------------------------------------------------------------------------------------


def _triangulate(vertices: Floats, corner_vertex: Integers, face_start: Integers) -> Integers:
    """(m, 3) corner numbers: quads along the diagonal that folds nothing, larger faces by fans or ears."""
    sizes = np.diff(face_start)
    if (sizes == 3).all():
        return np.arange(len(corner_vertex)).reshape(-1, 3)
    parts = [face_start[:-1][sizes == 3, None] + np.arange(3)]
    faces = [np.flatnonzero(sizes == 3)]
    for size in np.unique(sizes[sizes > 3]):
        chosen = np.flatnonzero(sizes == size)
        corners = face_start[chosen, None] + np.arange(size)
        points = vertices[corner_vertex[corners]]
        normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell
        order = _fan(size)
        convex = _agrees(points, order, normal)
        if size == 4:
            other = np.array([[1, 2, 3], [1, 3, 0]])
            convex |= ~_agrees(points, other, normal)  # neither diagonal is better: keep the first
            triangles = np.where(convex[:, None, None], corners[:, order], corners[:, other])
        else:
            triangles = corners[:, order]
            for i in np.flatnonzero(~convex):
                triangles[i] = corners[i][_ears(points[i], normal[i])]
        parts.append(triangles.reshape(-1, 3))
        faces.append(np.repeat(chosen, size - 2))
    return np.concatenate(parts)[np.argsort(np.concatenate(faces), kind="stable")]


def _fan(size: int) -> Integers:
    return np.stack([np.zeros(size - 2, dtype=int), np.arange(1, size - 1), np.arange(2, size)], axis=1)


def _agrees(points: Floats, triangles: Integers, normal: Floats) -> Booleans:
    """(f,) whether all triangles of a face (f, size, 3) wind like the face itself."""
    a, b, c = (points[:, triangles[:, i]] for i in range(3))
    return np.asarray((np.einsum("ftx,fx->ft", np.cross(b - a, c - a), normal) >= 0).all(axis=1))


def _ears(points: Floats, normal: Floats) -> Integers:
    """(size - 2, 3) a triangulation of one polygon (size, 3) by ear clipping."""
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, axis, axis=1)
    flat[:, 0] *= np.sign(normal[axis])  # seen from the side that the normal points to
    if axis == 1:  # dropping y leaves (x, z), a left-handed plane
        flat = flat[:, ::-1]

    def cross(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))

    left = list(range(len(points)))
    triangles = []
    while len(left) > 3:
        ears = []
        for i in range(len(left)):
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            others = [p for p in left if p not in (a, b, c)]
            inside = any(
                cross(a, b, p) >= 0 and cross(b, c, p) >= 0 and cross(c, a, p) >= 0 and cross(a, b, c) > 0
                for p in others
            )
            ears.append(-np.inf if inside else cross(a, b, c))
        i = int(np.argmax(ears))
        triangles.append((left[i - 1], left[i], left[(i + 1) % len(left)]))
        del left[i]
    return np.array([*triangles, tuple(left)])


# --- the working copy ---------------------------------------------------------------------------------------


def _working_mesh(surface: Surface) -> WorkingMesh:
    triangles = surface.triangles
    sides = _sides_by_edge(triangles)
    welded = _weld(surface.vertices, triangles, sides)
    triangles = welded[triangles]
    proper = np.all(triangles != np.roll(triangles, 1, axis=1), axis=1)
    if not (proper.all() and (triangles == surface.triangles).all()):
        triangles = triangles[proper]
        sides = _sides_by_edge(triangles)
    used = np.zeros(len(surface.vertices), dtype=bool)
    used[triangles] = True
    number = np.where(used, np.cumsum(used) - 1, -1)
    triangles = number[triangles]

    scale = float(np.sqrt(surface.area))
    points = surface.vertices[used]
    points = (points - points.mean(axis=0)) / scale
    referenced = np.zeros(len(surface.vertices), dtype=bool)
    referenced[surface.corner_vertex] = True
    return WorkingMesh(
        vertices=points,
        triangles=triangles,
        flipped=_flipped(points, triangles, sides),
        vertex_of=np.where(referenced, number[welded], -1),
        triangle_of=np.flatnonzero(proper),
        component=_component(points, triangles),
        scale=scale,
    )


def _weld(vertices: Floats, triangles: Integers, sides: _Sides) -> Integers:
    """(n,) the vertex that stands for each: coinciding border vertices become one, all others stay."""
    side, first = sides
    alone = side[first[:-1][np.diff(first) == 1]]
    border = np.unique(np.concatenate([triangles.ravel()[alone], np.roll(triangles, -1, axis=1).ravel()[alone]]))
    stands_for = np.arange(len(vertices))
    if len(border) == 0:
        return stands_for
    points = vertices[border]
    extent = float(np.ptp(vertices[triangles.ravel()], axis=0).max())
    lattice = np.rint((points - points.min(axis=0)) / (extent * WELD_TOLERANCE)).astype(np.int64)
    keys = (lattice[:, 0] << 42) | (lattice[:, 1] << 21) | lattice[:, 2]
    _, begin, group = np.unique(keys, return_index=True, return_inverse=True)
    stands_for[border] = border[begin[group]]
    return stands_for


def _component(vertices: Floats, triangles: Integers) -> Integers:
    """(n,) connected components, numbered by falling area."""
    n = len(vertices)
    rows, columns = triangles[:, [0, 1]].ravel(), triangles[:, [1, 2]].ravel()
    count, label = connected_components(
        coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(n, n)), directed=False
    )
    if count == 1:
        return label.astype(np.int64)
    area = np.bincount(label[triangles[:, 0]], triangle_areas(vertices, triangles))
    rank = np.empty(len(area), dtype=int)
    rank[np.argsort(-area, kind="stable")] = np.arange(len(area))
    return rank[label]


def _flipped(vertices: Floats, triangles: Integers, sides: _Sides) -> Booleans:
    """(m,) which triangles to turn so that neighbours agree and normals point outwards."""
    side, first = sides
    m, count = len(triangles), np.diff(first)
    pair = first[:-1][count == 2]  # manifold edges alone carry an orientation across
    left, right = side[pair], side[pair + 1]
    forward = (triangles < np.roll(triangles, -1, axis=1)).ravel()
    agree = forward[left] != forward[right]
    left, right = left // 3, right // 3
    if agree.all():
        turned = np.zeros(m, dtype=bool)
        _, patch = connected_components(coo_array((agree, (left, right)), shape=(m, m)), directed=False)
        oriented = triangles
    else:
        turned, patch = _agreeing(m, left, right, agree)
        oriented = np.where(turned[:, None], triangles[:, ::-1], triangles)
    area, volume = _area_and_volume(vertices[oriented], patch)
    has_border = np.zeros(len(area), dtype=bool)
    has_border[patch[side[np.repeat(count != 2, count)] // 3]] = True
    inward = volume < -np.where(has_border, FLAT_VOLUME, NO_VOLUME) * _sphere(area)
    return turned ^ inward[patch]


def _agreeing(m: int, left: Integers, right: Integers, agree: Booleans) -> tuple[Booleans, Integers]:
    """Which of m triangles to turn so that neighbours wind alike.

    The orientation double cover: each triangle stands there twice, kept and turned; neighbours that agree
    are joined copy to copy, the others crosswise. A sheet that contains one copy of each triangle is a
    consistent winding.

    Args:
        m: number of triangles.
        left: (e,) one of the two triangles at an edge.
        right: (e,) the other one.
        agree: (e,) whether they wind alike.

    Returns:
        (m,) whether to turn each, and (m,) the number of the patch that each belongs to.
    """
    rows = np.concatenate([left, left + m])
    columns = np.concatenate([np.where(agree, right, right + m), np.where(agree, right + m, right)])
    _, sheet = connected_components(
        coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(2 * m, 2 * m)), directed=False
    )
    # Of the two sheets over a patch take the one that keeps more triangles (a Moebius band has one: keep all).
    kept = np.bincount(sheet[:m], minlength=2 * m)
    turned = kept[sheet[m:]] > kept[sheet[:m]]
    tie = kept[sheet[m:]] == kept[sheet[:m]]
    turned[tie] = sheet[m:][tie] < sheet[:m][tie]
    return turned, np.minimum(sheet[:m], sheet[m:])


def _area_and_volume(corners: Floats, patch: Integers) -> tuple[Floats, Floats]:
    """The area (p,) of patches of triangles (m, 3, 3), and the signed volume between them and their centroids.

    Args:
        corners: positions.
        patch: (m,) number of the patch that each triangle belongs to.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area_normal = _cross(b - a, c - a)
    centre = (a + b + c) / 3
    size = np.sqrt(np.einsum("mx,mx->m", area_normal, area_normal)) / 2
    area = np.bincount(patch, size)
    middle = np.stack([np.bincount(patch, size * centre[:, i]) for i in range(3)], axis=1)
    middle = middle / np.where(area > 0, area, 1)[:, None]
    volume = np.bincount(patch, np.einsum("ij,ij->i", centre - middle[patch], area_normal) / 6)
    return area, volume


def _sphere(area: Floats) -> Floats:
    """The volume of spheres of the given areas."""
    return area**1.5 / (6 * np.sqrt(np.pi))
