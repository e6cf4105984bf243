# SPDX-License-Identifier: GPL-3.0-or-later
"""Every accepted form of a shape gives the same surface; other objects raise a clear error."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from creatures import creature

import zoomout_core as zo
from zoomout_core.mesh.shapes import as_shape, as_surface


@pytest.fixture(scope="module")
def surface() -> zo.Surface:
    return creature(300).surface


@pytest.fixture(params=["surface", "arrays", "list", "trimesh", "triangles", "path", "text"])
def given(request: pytest.FixtureRequest, surface: zo.Surface, tmp_path: Path) -> Any:
    """The surface in each form that users may pass."""
    vertices, triangles = surface.vertices, surface.triangles
    if request.param in ("path", "text"):
        path = tmp_path / "mesh.ply"
        trimesh.Trimesh(vertices, triangles, process=False).export(path, vertex_normal=False)
        return path if request.param == "path" else str(path)
    return {
        "surface": surface,
        "arrays": (vertices, triangles),
        "list": [vertices.tolist(), triangles.tolist()],
        "trimesh": trimesh.Trimesh(vertices, triangles, process=False),
        "triangles": SimpleNamespace(vertices=vertices, triangles=triangles),
    }[request.param]


def test_all_forms_give_the_same_surface(given: Any, surface: zo.Surface) -> None:
    found = as_surface(given)
    np.testing.assert_allclose(found.vertices, surface.vertices, atol=1e-6)
    np.testing.assert_array_equal(found.triangles, surface.triangles)


def test_public_functions_accept_all_forms(surface: zo.Surface) -> None:
    arrays = surface.vertices, surface.triangles
    mesh = trimesh.Trimesh(*arrays, process=False)
    basis = zo.eigenbasis(surface, 8)
    np.testing.assert_allclose(zo.eigenbasis(mesh, 8).eigenvalues, basis.eigenvalues)
    np.testing.assert_allclose(zo.hamiltonian_basis(arrays, np.zeros(300), 8).eigenvalues, basis.eigenvalues, atol=1e-6)
    np.testing.assert_allclose(zo.shot(mesh), zo.shot(surface), atol=1e-12)
    result = zo.match(mesh, arrays, initial="proximity", k_final=20, samples=100)
    expected = zo.match(surface, surface, initial="proximity", k_final=20, samples=100)
    np.testing.assert_array_equal(result.surface_map.vertex, expected.surface_map.vertex)
    values = zo.Attribute("x", zo.Domain.POINT, zo.Kind.SCALAR, surface.vertices[:, 0].copy())
    carried = zo.transfer(values, result, mesh, arrays)
    np.testing.assert_array_equal(carried.values, zo.transfer(values, expected, surface, surface).values)


def test_points_without_faces_are_a_cloud(surface: zo.Surface) -> None:
    cloud = as_shape(trimesh.PointCloud(surface.vertices))
    assert isinstance(cloud, zo.PointCloud)
    assert as_shape(cloud) is cloud


@pytest.mark.parametrize("wrong", [3, None, np.zeros((4, 3)), {"vertices": 1}])
def test_other_types_are_refused(wrong: Any, surface: zo.Surface) -> None:
    with pytest.raises(
        TypeError, match=r"A mesh is needed, not a .*: give a Surface, a PointCloud, \(vertices, faces\)"
    ):
        zo.match(surface, wrong)
    with pytest.raises(TypeError, match="A mesh is needed"):
        zo.eigenbasis(wrong)
