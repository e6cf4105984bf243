# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes of trimesh, meshio and Open3D: they are recognised by their attributes, so none has to be installed."""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.mesh.formats.files import polygons_of_scene
from zoomout_core.mesh.formats.meshio_files import faces_of_meshio
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.surface import Surface


class MeshLike(Protocol):
    """A mesh with `vertices` (n, 3), such as trimesh's and Open3D's; (m, 3) `faces` or `triangles` are optional."""

    @property
    def vertices(self) -> Any: ...


class SceneLike(Protocol):
    """A `trimesh.Scene`: meshes by name, and the graph of their transforms."""

    @property
    def geometry(self) -> Any: ...

    @property
    def graph(self) -> Any: ...


class PointsLike(Protocol):
    """A `meshio.Mesh`, or a point cloud of Open3D: `points` (n, 3), with `cells` or `normals`."""

    @property
    def points(self) -> Any: ...


class TensorMeshLike(Protocol):
    """A mesh of `open3d.t.geometry`: tensors by name for vertices and triangles."""

    @property
    def vertex(self) -> Any: ...

    @property
    def triangle(self) -> Any: ...


class TensorCloudLike(Protocol):
    """A point cloud of `open3d.t.geometry`: tensors by name."""

    @property
    def point(self) -> Any: ...


LibraryShape: TypeAlias = MeshLike | SceneLike | PointsLike | TensorMeshLike | TensorCloudLike


def library_shape(shape: Any) -> Surface | PointCloud | None:
    """A shape of another library as one of ours; None if it is not such a shape.

    Raises:
        MeshError: it is invalid.
    """
    if _has(shape, "vertices"):
        faces = getattr(shape, "faces", getattr(shape, "triangles", None))
        return _shape(shape.vertices, faces)
    if _has(shape, "geometry", "graph"):
        vertices, corner_vertex, face_start = polygons_of_scene(shape)
        return Surface.from_corners(vertices, corner_vertex, face_start) if len(corner_vertex) else _shape(vertices)
    if _has(shape, "points", "cells"):
        positions, corner_vertex, face_start = faces_of_meshio(shape)
        return Surface.from_corners(positions, corner_vertex, face_start) if len(corner_vertex) else _shape(positions)
    if _has(shape, "vertex", "triangle"):
        return _shape(_tensor(shape.vertex, "positions"), _tensor(shape.triangle, "indices"))
    if _has(shape, "point"):
        return _shape(_tensor(shape.point, "positions"), None, _tensor(shape.point, "normals"))
    if _has(shape, "points", "normals"):
        return _shape(shape.points, None, shape.normals)
    return None


def _has(shape: object, *names: str) -> bool:
    return all(hasattr(shape, name) for name in names)


def _shape(points: Any, faces: Any = None, normals: Any = None) -> Surface | PointCloud:
    """The surface of faces (m, 3), or the cloud of points (n, 3), which may have normals (n, 3)."""
    if faces is not None:
        return Surface(np.asarray(points), np.asarray(faces))
    known = normals is not None and len(normals)
    return PointCloud(np.asarray(points), np.asarray(normals) if known else None)


def _tensor(tensors: Any, name: str) -> Floats:
    """A tensor (n, 3) of Open3D, on any device; empty if there is none of that name."""
    if name not in tensors:
        return np.zeros((0, 3))
    tensor = tensors[name]
    return np.asarray((tensor.cpu() if hasattr(tensor, "cpu") else tensor).numpy())
