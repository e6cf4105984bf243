# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes of other libraries are accepted as they are; an error names missing data."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from creatures import creature

import zoomout_core as zo
from zoomout_core.mesh.shapes import as_shape

SURFACE = creature(100).surface
VERTICES, TRIANGLES = SURFACE.vertices, SURFACE.triangles
MESH = trimesh.Trimesh(VERTICES, TRIANGLES, process=False)


class Tensor:
    """As Open3D's: its numbers are read from the processor's memory."""

    def __init__(self, values: Any, on_gpu: bool = False) -> None:
        self._values, self._on_gpu = np.asarray(values), on_gpu

    def cpu(self) -> Tensor:
        return Tensor(self._values)

    def numpy(self) -> Any:
        assert not self._on_gpu
        return self._values


def of_meshio(points: Any, cells: list[tuple[str, Any]]) -> SimpleNamespace:
    """As a `meshio.Mesh`."""
    return SimpleNamespace(points=points, cells=[SimpleNamespace(type=kind, data=data) for kind, data in cells])


def scene(*transforms: Any) -> trimesh.Scene:
    made = trimesh.Scene()
    for transform in transforms:
        made.add_geometry(MESH, transform=transform)
    return made


class Vectors:
    """As Open3D's `Vector3dVector`: it becomes an array, and has a length."""

    def __init__(self, values: Any) -> None:
        self._values = np.asarray(values)

    def __len__(self) -> int:
        return len(self._values)

    def __array__(self, *_: Any, **__: Any) -> Any:
        return self._values


SURFACES: dict[str, Any] = {
    "a mesh of trimesh": MESH,
    "a scene of trimesh": scene(np.eye(4)),
    "a mesh of meshio": of_meshio(VERTICES, [("triangle", TRIANGLES)]),
    "faces beside solid cells": of_meshio(
        VERTICES, [("tetra", TRIANGLES[:1].repeat(2)[:4][None]), ("triangle", TRIANGLES)]
    ),
    "a mesh of Open3D": SimpleNamespace(vertices=Vectors(VERTICES), triangles=Vectors(TRIANGLES)),
    "tensors": SimpleNamespace(
        vertex={"positions": Tensor(VERTICES.astype(np.float32))}, triangle={"indices": Tensor(TRIANGLES)}
    ),
    "tensors on a GPU": SimpleNamespace(
        vertex={"positions": Tensor(VERTICES, True)}, triangle={"indices": Tensor(TRIANGLES, True)}
    ),
}
CLOUDS: dict[str, tuple[Any, bool]] = {
    "points of trimesh": (trimesh.PointCloud(VERTICES), False),
    "points of a scene": (trimesh.Scene([trimesh.PointCloud(VERTICES)]), False),
    "points of meshio": (of_meshio(VERTICES, []), False),
    "points of Open3D": (SimpleNamespace(points=Vectors(VERTICES), normals=Vectors(np.zeros((0, 3)))), False),
    "points of Open3D with normals": (SimpleNamespace(points=Vectors(VERTICES), normals=Vectors(VERTICES)), True),
    "points of tensors": (SimpleNamespace(point={"positions": Tensor(VERTICES)}), False),
    "points of tensors with normals": (
        SimpleNamespace(point={"positions": Tensor(VERTICES), "normals": Tensor(VERTICES)}),
        True,
    ),
}


@pytest.mark.parametrize("name", SURFACES)
def test_surfaces_of_other_libraries_are_accepted(name: str) -> None:
    found = as_shape(SURFACES[name])
    assert isinstance(found, zo.Surface)
    np.testing.assert_allclose(found.vertices, VERTICES, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(found.triangles, TRIANGLES)


@pytest.mark.parametrize("name", CLOUDS)
def test_point_clouds_of_other_libraries_are_accepted(name: str) -> None:
    shape, has_normals = CLOUDS[name]
    found = as_shape(shape)
    assert isinstance(found, zo.PointCloud)
    np.testing.assert_allclose(found.points, VERTICES)
    assert (found.normals is not None) == has_normals


def test_scene_equals_its_exported_file(tmp_path: Any) -> None:
    moved = trimesh.transformations.translation_matrix([5, 0, 0])
    mirrored = np.diag([-1.0, 1, 1, 1])
    made = scene(np.eye(4), moved, mirrored)
    made.export(tmp_path / "scene.glb")
    read, given = zo.read_surface(tmp_path / "scene.glb"), as_shape(trimesh.load(tmp_path / "scene.glb", process=False))
    assert isinstance(given, zo.Surface)
    assert len(given.vertices) == 300
    np.testing.assert_allclose(given.vertices, read.vertices)
    np.testing.assert_array_equal(given.triangles, read.triangles)


def test_match_accepts_shapes_of_other_libraries() -> None:
    result = zo.match(scene(np.eye(4)), SURFACES["a mesh of meshio"], initial="proximity", k_final=20)
    assert len(result.surface_map.vertex) == 100


WRONG: dict[str, Any] = {
    "an empty scene": trimesh.Scene(),
    "a mesh without vertices": trimesh.Trimesh(),
    "too few points": SimpleNamespace(points=np.zeros((3, 3)), normals=np.zeros((0, 3))),
    "points of two coordinates": SimpleNamespace(vertices=np.zeros((20, 2))),
    "tensors of other numbers": SimpleNamespace(
        vertex={"positions": Tensor(VERTICES)}, triangle={"indices": Tensor(TRIANGLES + 100)}
    ),
    "a mesh without tensors": SimpleNamespace(vertex={}, triangle={}),
    "points without tensors": SimpleNamespace(point={}),
    "only lines": of_meshio(VERTICES[:5], [("line", np.array([[0, 1]]))]),
    "only points": SimpleNamespace(points=VERTICES),
    "a graph": SimpleNamespace(graph=1),
    "a class": trimesh.Trimesh,
}


@pytest.mark.parametrize("name", WRONG)
def test_unusable_objects_raise_one_sentence(name: str) -> None:
    with pytest.raises((TypeError, zo.MeshError), match=r"(?s)^[A-Z].*[a-z].*\.$"):
        as_shape(WRONG[name])
