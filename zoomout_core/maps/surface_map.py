# SPDX-License-Identifier: GPL-3.0-or-later
"""A map between surfaces: a point on the source for every vertex of the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from os.path import isfile
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from zoomout_core.arrays import AnyFloats, Booleans, Floats, Integers, fill_masked, take_rows
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals
from zoomout_core.messages import as_message, message
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays, write_arrays
from zoomout_core.runtime.input_files import check_path
from zoomout_core.runtime.outputs import atomic_write
from zoomout_core.runtime.summary import Summary

# Barycentric coordinates may miss their bounds and their sum by this rounding error.
BARYCENTRIC_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceMap(Summary):
    """The point on the source surface that each vertex of the target corresponds to.

    Attributes:
        triangle: (n_t,) the source triangle that contains the image.
        barycentric: (n_t, 3) the image in that triangle, non-negative, summing to one.
        source_triangles: (m_s, 3) vertex numbers of the source's triangles.

    Example:
        >>> surface_map = zo.SurfaceMap.from_vertices(truth, source)
        >>> bool((surface_map.vertex == truth).all())
        True
    """

    triangle: Integers
    barycentric: Floats
    source_triangles: Integers

    @classmethod
    def from_vertices(cls, vertex: ArrayLike, source: Surface) -> SurfaceMap:
        """The map that sends each target vertex to a source vertex (n_t,).

        Raises:
            ValueError: these are not numbers of the source's vertices.
            MeshError: a vertex has no face.
        """
        triangles = source.triangles
        vertex = vertex_numbers(vertex, len(source.vertices), "Images on the source")
        corner_at = np.full(len(source.vertices), -1)
        corner_at[triangles.ravel()] = np.arange(triangles.size)
        corner = corner_at[vertex]
        if (corner < 0).any():
            raise MeshError(
                "The map points to vertex {vertex} of the source, which belongs to no face: correct the map.",
                vertex=vertex[corner < 0][0],
            )
        barycentric = np.zeros((len(vertex), 3))
        barycentric[np.arange(len(vertex)), corner % 3] = 1
        return cls(corner // 3, barycentric, triangles)

    def _summary(self) -> dict[str, str]:
        return {"target": f"{len(self.triangle):,} vertices", "source": f"{len(self.source_triangles):,} triangles"}

    @property
    def vertex(self) -> Integers:
        """(n_t,) the source vertex nearest to each image."""
        corner = np.argmax(self.barycentric, axis=1)
        return self.source_triangles[self.triangle, corner]

    def interpolate(self, values: Floats) -> Floats:
        """Interpolate values (n_s,) or (n_s, d) at the source's vertices to the images: (n_t,) or (n_t, d).

        Raises:
            ValueError: there are fewer values than vertices, or they are not numbers in an array.

        Example:
            >>> heights = result.surface_map.interpolate(source.vertices[:, 2])
            >>> heights.shape == (len(target.vertices),)
            True
        """
        given, needed = np.asarray(fill_masked(values)), int(self.source_triangles.max(initial=-1)) + 1
        if given.dtype.kind not in "biufc":
            raise ValueError(f"Values of type {type(values).__name__} ({given.dtype}) are not an array of numbers.")
        if not given.ndim or len(given) < needed:
            raise ValueError(f"Values of shape {given.shape} cannot be read at {needed} vertices: give one for each.")
        corners = take_rows(self.source_triangles, self.triangle)
        if given.size == len(given):  # a single column needs no large array of the corners' values
            return np.einsum("nc,nc...->n...", self.barycentric, take_rows(given, corners))
        mixed = interpolation_matrix(corners, self.barycentric, len(given)) @ given.reshape(len(given), -1)
        return np.asarray(mixed).reshape(len(corners), *given.shape[1:])

    def at(self, source: Surface, target: Surface, triangle: Integers, barycentric: Floats) -> SurfaceMap:
        """The map at points (q, 3) in the target's triangles (q,), such as corners or samples inside its faces.

        The images of the corners are mixed in space, and the mixture is projected to the source.

        Raises:
            ValueError: these are not numbers of the target's triangles.
        """
        triangle = vertex_numbers(triangle, len(target.triangles), "Triangles of the target", "triangle")
        images = self.interpolate(source.vertices)[target.triangles[triangle]]
        points = np.einsum("qc,qcx->qx", barycentric, images)
        return SurfaceMap(*closest_points(points, source.vertices, self.source_triangles), self.source_triangles)

    def invert(self, source: Surface, target: Surface) -> SurfaceMap:
        """The inverse map: a point on the target for every vertex of the source.

        Each source vertex takes the closest point of the target, with the target's vertices moved to their images.

        Example:
            >>> result.surface_map.invert(source, target).vertex.shape == (len(source.vertices),)
            True
        """
        return self.preimages(source, target, source.vertices)

    def preimages(self, source: Surface, target: Surface, points: Floats) -> SurfaceMap:
        """The inverse map at points (q, 3) near the source: the point of the target with the nearest image."""
        images = self.interpolate(source.vertices)
        return SurfaceMap(*closest_points(points, images, target.triangles), target.triangles)

    def save(self, path: str | PathLike[str], **extra: Any) -> None:
        """Write `triangle`, `barycentric`, `vertex` and any further arrays to an .npz file.

        The extension .npz is added to a path without it; `load` does the same.

        Raises:
            OutputError: it cannot be written; the earlier file is unchanged.

        Example:
            >>> result.surface_map.save(folder / "map.npz", confidence=result.confidence)
        """
        arrays: dict[str, Any] = {"triangle": self.triangle, "barycentric": self.barycentric, "vertex": self.vertex}
        with atomic_write(_npz(path)) as part:
            write_arrays(part, arrays | extra)

    @classmethod
    def load(cls, path: str | PathLike[str], source: Surface) -> SurfaceMap:
        """Read a map that `save` wrote.

        Raises:
            MeshError: the file is missing, or contains no map, or a map onto another source.

        Example:
            >>> result.surface_map.save(folder / "map.npz")
            >>> again = zo.SurfaceMap.load(folder / "map.npz", source)
        """
        path = path if isfile(path) else _npz(path)
        arrays = arrays_of_map(path, ("triangle", "barycentric"))
        missing = {"triangle", "barycentric"}.difference(arrays)
        if missing:
            raise MeshError(
                "{path} contains no map, because it lacks {names}: choose another file.",
                path=path,
                names=" and ".join(sorted(missing)),
            )
        fault = fault_of_map(arrays["triangle"], arrays["barycentric"], len(source.triangles))
        if fault:
            raise MeshError(
                "{path} is not a map onto this source ({fault}): choose another file.",
                path=path,
                fault=as_message(fault),
            )
        triangle, barycentric = arrays["triangle"].astype(np.int64), arrays["barycentric"].astype(np.float64)
        return cls(triangle, barycentric, source.triangles)


def read_vertex_map(path: str | PathLike[str]) -> Integers:
    """The source vertex (n_t,) of each target vertex, from a file that `SurfaceMap.save` or `zoomout match` wrote.

    Unlike triangles, vertices have the same numbers in every program that reads the meshes.

    Raises:
        MeshError: the file is missing or invalid.
    """
    vertex = arrays_of_map(path, ("vertex",)).get("vertex")
    if vertex is None or vertex.ndim != 1 or vertex.dtype.kind not in "iu" or (vertex < 0).any():
        raise MeshError(
            "{path} contains no map, because it lists no vertices: choose a file written by `zoomout match`.", path=path
        )
    return vertex


def arrays_of_map(path: str | PathLike[str], names: Sequence[str]) -> dict[str, np.ndarray[Any, Any]]:
    """Read those of some arrays that the file of a map has; raises MeshError if it cannot be read."""
    try:
        return read_arrays(path, names)
    except FileNotFoundError:
        raise MeshError("There is no file {path}: check the path.", path=path) from None
    except (ArrayFileError, MemoryError) as error:
        raise MeshError(
            "{path} contains no map ({reason}): choose another file.",
            path=path,
            reason=as_message(str(error) or "it is too large"),
        ) from error


def _npz(path: str | PathLike[str]) -> str:
    """The path with the extension that numpy adds when writing."""
    check_path(path)
    name = fspath(path)
    return name if name.endswith(".npz") else f"{name}.npz"


def fault_of_map(triangle: Integers, barycentric: Floats, count: int) -> str:
    """The error in the arrays (n,) and (n, 3) of a map onto `count` triangles; empty if there is none."""
    if triangle.dtype.kind not in "iu" or barycentric.dtype.kind != "f":
        return message(
            "its triangles are of type {triangles} and its barycentric coordinates of {barycentric}",
            triangles=triangle.dtype,
            barycentric=barycentric.dtype,
        )
    if triangle.ndim != 1 or barycentric.shape != (len(triangle), 3):
        return message(
            "its triangles {triangles} and barycentric coordinates {barycentric} do not fit together",
            triangles=triangle.shape,
            barycentric=barycentric.shape,
        )
    wrong = triangle[(triangle < 0) | (triangle >= count)]
    if len(wrong):
        return message(
            "it refers to triangle {number} of {count}, so it was computed for another source",
            number=wrong[0],
            count=count,
        )
    off = np.maximum(np.abs(barycentric.sum(axis=1) - 1), -barycentric.min(axis=1, initial=0))
    if not (off <= BARYCENTRIC_TOLERANCE).all():
        return "its barycentric coordinates are not all numbers from 0 to 1 that sum to one"
    return ""


def interpolation_matrix(corners: Integers, barycentric: AnyFloats, n: int) -> scipy.sparse.csr_array:
    """(q, n) matrix that interpolates values at n vertices to points, by corners (q, 3) and barycentric coordinates.

    Its products need no array of the values at all corners.
    """
    begins = np.arange(0, 3 * len(corners) + 1, 3)
    return scipy.sparse.csr_array((barycentric.ravel(), corners.ravel(), begins), shape=(len(corners), n))


def folded_triangles(images: Floats, normals: Floats, triangles: Integers) -> Booleans:
    """(m,) which triangles (m, 3) of the target a map flips: their images (n_t, 3) face against the source.

    The normals (n_t, 3) of the source at the images need not have unit length.
    """
    facing = np.einsum("mx,mcx->m", triangle_normals(images, triangles), normals[triangles])
    return np.asarray(facing < 0)
