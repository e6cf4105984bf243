# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of the arrays that a user gives for a mesh: positions, faces, edges, numbers of vertices.

Errors name the fault in one sentence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Booleans, Floats, Integers, fill_masked, to_array
from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import plural

# Larger coordinates overflow when areas are squared.
MAX_COORDINATE = 1e75
# Vertices of one face must not be further away than this, relative to the median vertex: compared with such a face, all
# others would vanish in rounding.
MAX_RELATIVE_DISTANCE = 1e6
# Number of face corners, about, from which the median is computed.
MEDIAN_CORNERS = 10_000


def measurable(points: Floats) -> Booleans:
    """(n,) which points (n, 3) have coordinates that are finite and at most `MAX_COORDINATE`."""
    return np.asarray((np.abs(points) <= MAX_COORDINATE).all(axis=1))  # false for NaN


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


def check_points(points: ArrayLike) -> Floats:
    """(n, 3) positions as an array; they need not be finite.

    Raises:
        MeshError: they are not numbers, or not three for each vertex.
    """
    try:
        if isinstance(points, np.ndarray) and points.dtype.kind in "cmM":  # complex numbers, durations and dates
            raise TypeError
        array = np.array(fill_masked(points), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise MeshError("Positions must be numbers, three for each vertex.") from None
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"Positions must be an array of shape (n, 3), not {array.shape}.")
    return array


def flatten_faces(faces: ArrayLike | Sequence[Sequence[int]]) -> tuple[Integers, Integers]:
    """(c,) corners and (f + 1,) face starts of an array of faces or a list of polygons.

    Raises:
        MeshError: faces are not sequences of whole numbers.
    """
    if isinstance(faces, np.ndarray) and faces.ndim == 2:
        return whole_numbers(faces.ravel()), np.arange(len(faces) + 1) * faces.shape[1]
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
    return whole_numbers(corners), np.concatenate([[0], np.cumsum(sizes)])


def whole_numbers(numbers: ArrayLike) -> Integers:
    """Numbers of elements as integers; integral floats, as some files and programs have, are accepted.

    Raises:
        MeshError: some are not whole numbers.
    """
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


def check_triangles(triangle_corners: ArrayLike, corner_count: int) -> Integers:
    """(m, 3) corners of a triangulation.

    Raises:
        MeshError: the array has another shape, or numbers that are not corners.
    """
    triangles = whole_numbers(triangle_corners)
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        raise MeshError(f"A triangulation must be an array of shape (m, 3), not {triangles.shape}: correct it.")
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < corner_count):
        raise MeshError(f"The triangulation names corner {triangles.max()}, but there are {corner_count}: correct it.")
    return triangles


def check_edges(edges: ArrayLike, vertex_count: int) -> Integers:
    """(e, 2) vertex numbers of edges.

    Raises:
        MeshError: the array has another shape, or numbers that are not vertices.
    """
    array = whole_numbers(edges)
    if array.ndim != 2 or array.shape[1] != 2:
        raise MeshError(f"Edges must be an array of shape (e, 2), not {array.shape}.")
    if array.size and not (array.min() >= 0 and array.max() < vertex_count):
        wrong = array[(array < 0) | (array >= vertex_count)][0]
        raise MeshError(f"An edge refers to vertex {wrong}, but the mesh has {vertex_count} vertices, numbered from 0.")
    return array


def check_faces(vertices: Floats, corner_vertex: Integers, face_start: Integers) -> None:
    """Check faces, and the coordinates of the vertices that they use.

    Raises:
        MeshError: there are no faces, or one has fewer than three corners; the arrays are inconsistent; or coordinates
            are not finite or too far from the others.
    """
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
            plural(
                len(broken),
                "Vertex {vertex} has coordinates that are not finite or far too large: remove or repair it.",
                "{count:,} vertices have coordinates that are not finite or far too large (the first is "
                "vertex {vertex}): remove or repair them.",
                vertex=broken[0],
            )
        )
    _check_distances(vertices, corner_vertex, face_start)


def _check_distances(vertices: Floats, corner_vertex: Integers, face_start: Integers) -> None:
    """Reject faces between vertices that are close together and vertices that are extremely far away."""
    some = vertices[corner_vertex[:: 1 + len(corner_vertex) // MEDIAN_CORNERS]]
    middle = np.median(some, axis=0)
    farthest = MAX_RELATIVE_DISTANCE * np.median(np.linalg.norm(some - middle, axis=1))
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
            times=MAX_RELATIVE_DISTANCE,
        )
