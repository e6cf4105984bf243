# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices that are not numbers keep their place in an asset, and lose their faces; other data stays where it was."""

from __future__ import annotations

import json
from base64 import b64encode
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from broken_gltf import DATA, content_of, document
from creatures import creature
from interfaces import run
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.assets.asset import MATERIALS, WEIGHTS, Asset, Skin, to_rest
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.cli import main

SQUARE = ["0 0 0", "1 0 0", "1 1 0", "0 1 0", "nan 5 0"]


def broken_obj(path: Path) -> None:
    lines = [*(f"v {each}" for each in SQUARE), "vt 0 0", "vt 0.5 0", "vt 0.25 1"]
    lines += ["usemtl Red", "f 1/1 2/2 5/3", "usemtl Blue", "f 1/1 2/2 3/3", "f 1/1 3/3 4/2", ""]
    path.write_text("\n".join(lines))


def broken_ply(path: Path) -> None:
    header = ["ply", "format ascii 1.0", "element vertex 5", *(f"property float {axis}" for axis in "xyz")]
    header += ["element face 3", "property list uchar int vertex_indices", "property list uchar float texcoord"]
    faces = ["3 0 1 4 6 0 0 0.5 0 0.25 1", "3 0 1 2 6 0 0 0.5 0 0.25 1", "3 0 2 3 6 0 0 0.25 1 0.5 0"]
    path.write_text("\n".join([*header, "end_header", *SQUARE, *faces, ""]))


@pytest.mark.parametrize(("name", "write"), [("a.obj", broken_obj), ("a.ply", broken_ply)])
def test_faces_of_broken_vertices_are_left_out(name: str, write: object, tmp_path: Path) -> None:
    path = tmp_path / name
    assert callable(write)
    write(path)
    asset = zo.read_asset(path)
    assert asset.surface.triangles.tolist() == zo.read_surface(path).triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert np.isnan(asset.surface.vertices).any(axis=1).tolist() == [False] * 4 + [True]
    uv = asset.find("uv 0")
    assert uv is not None
    assert np.asarray(uv.values).tolist() == [[0, 0], [0.5, 0], [0.25, 1], [0, 0], [0.25, 1], [0.5, 0]]
    materials = asset.find(MATERIALS)
    if name == "a.obj":
        assert materials is not None
        assert [asset.materials[number].name for number in np.asarray(materials.values).tolist()] == ["Blue", "Blue"]
    zo.write_asset(asset, tmp_path / f"again{path.suffix}")
    assert zo.read_asset(tmp_path / f"again{path.suffix}").surface.vertices.shape == (5, 3)


def test_gltf_faces_of_nan_vertices_are_left_out(tmp_path: Path) -> None:
    tree = document()
    data = DATA + np.array([[np.nan, 0, 0], [0, 0, 0], [1, 0, 0], [1, 1, 0]], "<f4").tobytes()
    data += np.array([0, 1, 2, 1, 2, 3, 0, 0], "<u2").tobytes()
    tree["buffers"] = [{"byteLength": len(data), "uri": f"data:;base64,{b64encode(data).decode()}"}]
    tree["bufferViews"] += [
        {"buffer": 0, "byteOffset": len(DATA), "byteLength": 48},
        {"buffer": 0, "byteOffset": len(DATA) + 48, "byteLength": 12},
    ]
    tree["accessors"] += [
        {"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 3, "componentType": 5123, "count": 6, "type": "SCALAR"},
    ]
    tree["meshes"][0]["primitives"][0] |= {"attributes": {"POSITION": 3}, "indices": 4, "targets": [{"POSITION": 3}]}
    (tmp_path / "a.gltf").write_bytes(content_of(tree))
    asset = zo.read_asset(tmp_path / "a.gltf")
    assert len(asset.surface.triangles) == 1
    assert np.isnan(asset.surface.vertices).any(axis=1).sum() == 1
    zo.write_asset(asset, tmp_path / "b.glb")
    assert len(zo.read_asset(tmp_path / "b.glb").surface.triangles) == 1


def test_skin_is_transferred_to_target_with_nan_vertex() -> None:
    surface = creature(300).surface
    weights = np.column_stack([np.ones(300), np.zeros(300)])
    transforms = np.tile(np.eye(4), (2, 1, 1))
    rest, linear = to_rest(surface.vertices, csr_array(weights), transforms)
    joints = np.arange(2), ("Root", "Tip"), np.array([-1, 0])
    skin = Skin(*joints, transforms, transforms, rest, linear, csr_array(weights))
    target = zo.Surface(np.vstack([surface.vertices + 3, [[np.nan] * 3]]), surface.triangles)
    numbers = np.append(np.arange(300), 0)
    match = SimpleNamespace(
        surface_map=zo.SurfaceMap.from_vertices(numbers, surface), confidence=np.ones(301), has_partner=None
    )
    made = transfer_asset(Asset(surface, skin=skin), Asset(target), match, [WEIGHTS])
    assert made.asset.skin is not None
    assert np.isfinite(made.asset.skin.rest).all()
    np.testing.assert_array_equal(made.asset.surface.vertices, target.vertices)


def test_command_reports_nan_vertices(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    surface = zo.read_surface(meshes[1])
    vertices = [" ".join(map(str, each)) for each in surface.vertices.tolist()]
    vertices[7] = "nan nan nan"
    header = ["ply", "format ascii 1.0", "element vertex 400", *(f"property double {axis}" for axis in "xyz")]
    header += [f"element face {len(surface.triangles)}", "property list uchar int vertex_indices", "end_header"]
    faces = [f"3 {a} {b} {c}" for a, b, c in surface.triangles.tolist()]
    (tmp_path / "broken.ply").write_text("\n".join([*header, *vertices, *faces, ""]))
    source = tmp_path / "source.obj"
    notes = zo.write_asset(Asset(zo.read_surface(meshes[0]), (colors(400),)), source)
    assert notes == ()
    options = ("--force", "--initial", "proximity", "--detail", "fast", "--json")
    ran = run(main, "transfer", source, tmp_path / "broken.ply", "-o", tmp_path / "out.ply", *options)
    assert ran.exit_code == 0, ran.output
    (entry,) = json.loads(ran.output[ran.output.index("{") :])["targets"]
    assert "1 vertex of the target is not a number: it and its faces are left out." in entry["notes"]
    assert zo.read_asset(tmp_path / "out.ply").surface.vertices.shape == (400, 3)


def colors(count: int) -> zo.Attribute:
    return zo.Attribute("color 0", zo.Domain.POINT, zo.Kind.COLOR, np.ones((count, 4)))
