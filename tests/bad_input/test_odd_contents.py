# SPDX-License-Identifier: GPL-3.0-or-later
"""Files with valid but unusual contents are read, and what is left out of them is noted."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from broken_gltf import content_of, document

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.formats.ply_files import strip_triangles
from zoomout_core.samples import creature

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def with_own_attribute(tree: dict[str, Any]) -> None:
    tree["meshes"][0]["primitives"][0]["attributes"]["_HEAT"] = 0


def with_unknown_extension(tree: dict[str, Any]) -> None:
    tree["extensionsRequired"] = ["EXT_bent_space", "KHR_materials_unlit"]


def add_accessor(tree: dict[str, Any], values: np.ndarray, kind: str) -> int:
    """Store an array in a document; the number of its accessor."""
    content = values.tobytes()
    tree["buffers"].append({"byteLength": len(content), "uri": f"data:;base64,{b64encode(content).decode()}"})
    tree["bufferViews"].append({"buffer": len(tree["buffers"]) - 1, "byteLength": len(content)})
    component = {"u1": 5121, "f4": 5126}[values.dtype.str[1:]]
    view = len(tree["bufferViews"]) - 1
    tree["accessors"].append({"bufferView": view, "componentType": component, "count": len(values), "type": kind})
    return len(tree["accessors"]) - 1


def with_joints(tree: dict[str, Any], joint: int = 0) -> None:
    tree["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = add_accessor(
        tree, np.full((3, 4), joint, "u1"), "VEC4"
    )
    tree["nodes"][2]["skin"], tree["skins"] = 0, [{"joints": [0, 1]}]


def with_weights(value: float) -> Callable[[dict[str, Any]], None]:
    """A change that gives all joints of all vertices a weight."""

    def change(tree: dict[str, Any]) -> None:
        with_joints(tree)
        weights = add_accessor(tree, np.full((3, 4), value, "<f4"), "VEC4")
        tree["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = weights

    return change


NOTED: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "an attribute of its own": (with_own_attribute, "contains the vertex attributes _HEAT, which are left out"),
    "an unknown extension": (with_unknown_extension, "requires EXT_bent_space, which is not read: check the meshes"),
    "weights that are not numbers": (with_weights(np.nan), "have no skin weights and follow the first joint"),
    "infinite weights": (with_weights(np.inf), "have no skin weights and follow the first joint"),
    "negative weights": (with_weights(-1), "have no skin weights and follow the first joint"),
    "joints without weights": (with_joints, "have no skin weights and follow the first joint"),
}


@pytest.mark.parametrize("name", NOTED)
def test_left_out_contents_of_gltf_are_noted(name: str, tmp_path: Path) -> None:
    change, said = NOTED[name]
    tree, path = document(), tmp_path / "odd.gltf"
    change(tree)
    path.write_bytes(content_of(tree))
    (note,) = zo.read_asset(path).notes
    assert said in note


def test_primitive_without_attributes_is_skipped(tmp_path: Path) -> None:
    tree, path = document(), tmp_path / "odd.gltf"
    tree["meshes"][0]["primitives"].append({"attributes": {}})
    path.write_bytes(content_of(tree))
    for surface in (zo.read_asset(path).surface, read_shape(path)):
        assert isinstance(surface, zo.Surface)
        assert len(surface.triangles) == 1


def test_rotation_of_zeros_is_named(tmp_path: Path) -> None:
    tree, path = document(), tmp_path / "odd.gltf"
    tree["nodes"][2]["rotation"] = [0, 0, 0, 0]
    path.write_bytes(content_of(tree))
    with pytest.raises(MeshError, match="the rotation of a node is 0, 0, 0, 0"):
        zo.read_asset(path)


def test_joint_beyond_the_skin_is_named(tmp_path: Path) -> None:
    tree, path = document(), tmp_path / "odd.gltf"
    with_joints(tree, 7)
    path.write_bytes(content_of(tree))
    with pytest.raises(MeshError, match="a vertex follows joint 7, but its skin has only 2 joints"):
        zo.read_asset(path)


@pytest.mark.parametrize(("joint", "refused"), [(1, True), (0, False)])
def test_singular_bind_matrix_is_named_where_it_is_used(joint: int, refused: bool, tmp_path: Path) -> None:
    tree, path = document(), tmp_path / "odd.gltf"
    with_joints(tree, joint)
    matrices = np.stack([np.eye(4), np.diag([1.0, 1, 0, 1])]).astype("<f4")
    tree["skins"][0]["inverseBindMatrices"] = add_accessor(tree, matrices, "MAT4")
    path.write_bytes(content_of(tree))
    if refused:
        with pytest.raises(MeshError, match=r"the inverse bind matrix of 'Tip' cannot be inverted"):
            zo.read_asset(path)
    else:
        assert zo.read_asset(path).surface.area > 0


def test_bind_matrix_that_is_not_finite_is_named(tmp_path: Path) -> None:
    tree, path = document(), tmp_path / "odd.gltf"
    with_joints(tree)
    matrices = np.stack([np.full((4, 4), np.nan), np.eye(4)]).astype("<f4")
    tree["skins"][0]["inverseBindMatrices"] = add_accessor(tree, matrices, "MAT4")
    path.write_bytes(content_of(tree))
    with pytest.raises(MeshError, match=r"the inverse bind matrix of 'Joint 0' cannot be inverted"):
        zo.read_asset(path)


@pytest.mark.parametrize("strip", [[[0, 1, 2, 3]], [[0, 1, 2], [2, 1, 3]], [[0, 1, 2, -1, 2, 1, 3]], [[0, 1, 2, 3, 3]]])
def test_strips_become_triangles(strip: list[list[int]]) -> None:
    assert strip_triangles(strip).tolist() == [[0, 1, 2], [2, 1, 3]]


def test_strips_of_ply_are_read(tmp_path: Path) -> None:
    path = tmp_path / "strips.ply"
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    path.write_text(header + "0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 2 3\n")
    assert zo.read_surface(path).area == zo.read_asset(path).surface.area == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (f"{OBJ}l 1 2 3\n", "contains points or lines, which are left out"),
        (f"{OBJ}p 1\n", "contains points or lines, which are left out"),
        (OBJ.replace("v 1 0 0", "v 1 0 0 1 0 0"), "has colors for only 1 of 3 vertices: they are left out"),
    ],
)
def test_left_out_contents_of_obj_are_noted(content: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.obj"
    path.write_text(content)
    (note,) = zo.read_asset(path).notes
    assert said in note


@pytest.mark.parametrize("ending", ["glb", "obj", "ply"])
def test_written_values_are_finite_and_complete(ending: str, tmp_path: Path) -> None:
    surface, path = creature(100).surface, tmp_path / f"a.{ending}"
    uv = np.random.default_rng(0).random((len(surface.corner_vertex), 2))
    uv[5] = np.nan
    (note,) = zo.write_asset(zo.Asset(surface, (uv_map(uv),)), path)
    assert note.startswith("1 of 588 values of 'uv 0' are not finite")
    written = zo.read_asset(path).find("uv 0")
    assert written is not None
    assert np.isfinite(written.values).all()
    with pytest.raises(MeshError, match="'uv 0' has 3 values for 588 corners: give one for each"):
        zo.write_asset(zo.Asset(surface, (uv_map(uv[:3]),)), path)


def uv_map(values: Floats) -> zo.Attribute:
    return zo.Attribute("uv 0", zo.Domain.CORNER, zo.Kind.UV, values)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32-le"])
def test_obj_in_unicode_of_windows_is_read(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.obj"
    path.write_bytes(OBJ.encode(encoding))
    if encoding == "utf-32-le":
        with pytest.raises(MeshError):
            zo.read_surface(path)
    else:
        assert zo.read_surface(path).area == zo.read_asset(path).surface.area == 0.5


def test_empty_file_name_is_named() -> None:
    with pytest.raises(MeshError, match="name of the file is empty: give its path"):
        zo.read_asset("")
