# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes as users pass them: a surface, a point cloud, arrays, another library's mesh, or the path of a file."""

from __future__ import annotations

from os import PathLike
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.input_checks import measurable
from zoomout_core.mesh.library_shapes import LibraryShape, library_shape
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.surface import Surface

# A surface, a point cloud, (vertices, faces), a mesh or a point cloud of another library, or the path of a file.
ShapeLike: TypeAlias = Surface | PointCloud | tuple[ArrayLike, ArrayLike] | LibraryShape | str | PathLike[str]


@memory_in_words
def as_shape(shape: ShapeLike) -> Surface | PointCloud:
    """Convert a user's shape to a surface or a point cloud.

    Args:
        shape: a surface or point cloud; positions (n, 3) with faces, as `Surface` takes them; the path of a mesh file;
            or a shape of another library: a mesh, scene or point cloud of trimesh, a `meshio.Mesh`, a mesh or point
            cloud of Open3D (its tensor classes included), or any object with `vertices` and `faces`.

    Raises:
        MeshError: it is invalid, or the file cannot be read.
        TypeError: it is none of these.
    """
    if isinstance(shape, Surface | PointCloud):
        return shape
    if isinstance(shape, str | PathLike):
        return read_shape(shape)
    if isinstance(shape, tuple | list) and len(shape) == 2:
        return Surface(*shape)
    found = library_shape(shape)
    if found is None:
        raise TypeError(
            f"A mesh is needed, not a {type(shape).__name__}: give a Surface, a PointCloud, (vertices, faces), the "
            "path of a file, or an object with vertices and faces, such as trimesh's."
        )
    return found


@memory_in_words
def as_surface(shape: ShapeLike) -> Surface:
    """Convert a user's shape to a surface; the surface of a point cloud is reconstructed.

    Raises:
        MeshError: it is invalid, or no surface passes through the points.
        TypeError: it is not a shape, see `as_shape`.
    """
    found = as_shape(shape)
    return found.surface if isinstance(found, PointCloud) else found


def as_placed_surface(shape: ShapeLike) -> Surface:
    """Convert a user's shape to a surface, all of whose vertices have a position; see `as_surface`, `place_unused`."""
    return place_unused(as_surface(shape))


def place_unused(surface: Surface) -> Surface:
    """A surface whose vertices that are not finite or far too large are moved to the centre of the others.

    No face uses them, so that its shape stays the same, and searches for nearest vertices work.
    """
    placed = measurable(surface.vertices)
    if placed.all():
        return surface
    return surface.with_vertices(np.where(placed[:, None], surface.vertices, surface.vertices[placed].mean(axis=0)))


def from_working(shape: Surface | PointCloud, values: Floats) -> Floats:
    """(n, d) values at a surface's vertices or a cloud's points, from those (m, d) at the working mesh's vertices.

    They are zero at a vertex without a face. A point that the surface leaves out gets the value of the nearest one.
    """
    vertex_of = as_surface(shape).working.vertex_of
    unused = vertex_of < 0
    found = values[vertex_of]
    found[unused] = 0
    if isinstance(shape, PointCloud):
        found[unused] = found[~unused][scipy.spatial.cKDTree(shape.points[~unused]).query(shape.points[unused])[1]]
    return found
