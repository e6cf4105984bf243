# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of other types than PNG keep their type, and material variants and free data of meshes are kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skinned_tubes import PNG, write_tube

from zoomout_core.assets.asset import Asset, Material, material_numbers
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.lods import make_lods
from zoomout_core.mesh.formats.gltf_document import Document
from zoomout_core.mesh.formats.gltf_files import parse_gltf
from zoomout_core.mesh.formats.image_types import image_type
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.version import package_version

JPEG = b"\xff\xd8\xff\xe0" + bytes(16)
WEBP = b"RIFF\x1a\0\0\0WEBPVP8L\x0d\0\0\0\x2f\0\0\0\x10\x07\x10\x11\x11\x88\x88\xfe\x07\0"
KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(68)
TGA = bytes([0, 0, 2, *bytes(9), 1, 0, 1, 0, 24, 0, 1, 2, 3])
BMP = b"BM" + bytes(24)


def tree_of(path: Path) -> dict[str, Any]:
    """The JSON of a file."""
    return parse_gltf(path.read_bytes())[0]


def write_textured(folder: Path, files: dict[str, bytes], texture: dict[str, Any]) -> Path:
    """Write a tube as .gltf with its buffer and images in files, and a texture that refers to these by number."""
    write_tube(folder / "tube.glb")
    tree, binary = parse_gltf((folder / "tube.glb").read_bytes())
    (folder / "data.bin").write_bytes(binary)
    tree["buffers"][0]["uri"] = "data.bin"
    for name, content in files.items():
        (folder / name).write_bytes(content)
    tree["images"] = [{"uri": name} for name in files]
    tree["textures"] = [texture]
    tree["extensionsUsed"] = list(texture.get("extensions", ()))
    (folder / "tube.gltf").write_text(json.dumps(tree))
    return folder / "tube.gltf"


EXTENSIONS = {"EXT_texture_webp": WEBP, "KHR_texture_basisu": KTX2}


@pytest.mark.parametrize("name", EXTENSIONS)
def test_an_image_keeps_its_type(name: str, tmp_path: Path) -> None:
    content = EXTENSIONS[name]
    kind = image_type(content)
    assert kind is not None
    path = write_textured(tmp_path, {"a.image": content}, {"extensions": {name: {"source": 0}}})
    asset = read_asset(path)
    assert asset.materials[0].image == content
    assert write_asset(asset, tmp_path / "again.glb") == ()
    tree = tree_of(tmp_path / "again.glb")
    assert tree["images"][0]["mimeType"] == kind.mime
    assert tree["textures"] == [{"extensions": {name: {"source": 0}}}]
    assert name in tree["extensionsUsed"]
    assert name in tree["extensionsRequired"]
    assert Document(tmp_path / "again.glb").image(0) == content
    write_asset(asset, tmp_path / "again.obj")
    assert (tmp_path / f"again_0{kind.suffix}").read_bytes() == content
    assert read_asset(tmp_path / "again.obj").materials[0].image == content


@pytest.mark.parametrize("name", EXTENSIONS)
def test_levels_of_detail_keep_images_of_any_type(name: str, tmp_path: Path) -> None:
    path = write_textured(tmp_path, {"a.image": EXTENSIONS[name]}, {"extensions": {name: {"source": 0}}})
    (level,) = make_lods(read_asset(path), [0.6])
    assert write_asset(level.asset, tmp_path / "level.glb") == ()
    assert Document(tmp_path / "level.glb").image(0) == EXTENSIONS[name]
    assert tree_of(tmp_path / "level.glb")["textures"] == [{"extensions": {name: {"source": 0}}}]


def test_png_fallback_is_preferred_and_both_images_are_kept(tmp_path: Path) -> None:
    texture = {"source": 1, "extensions": {"EXT_texture_webp": {"source": 0}}}
    path = write_textured(tmp_path, {"a.webp": WEBP, "a.png": PNG}, texture)
    asset = read_asset(path)
    assert asset.materials[0].image == PNG
    write_asset(asset, tmp_path / "again.gltf")
    tree = tree_of(tmp_path / "again.gltf")
    assert tree["textures"] == [texture]
    assert [each["uri"] for each in tree["images"]] == ["again_0.webp", "again_1.png"]
    assert tree["buffers"][0]["uri"] == "again.bin"
    assert "EXT_texture_webp" not in tree.get("extensionsRequired", [])
    (tmp_path / "a.png").unlink()
    asset = read_asset(path)
    assert asset.materials[0].image == WEBP
    assert len(asset.notes) == 1
    write_asset(asset, tmp_path / "one.glb")
    assert tree_of(tmp_path / "one.glb")["textures"] == [{"extensions": {"EXT_texture_webp": {"source": 0}}}]


@pytest.mark.parametrize(
    ("content", "kept"), [(PNG, True), (JPEG, True), (WEBP, True), (KTX2, True), (TGA, False), (BMP, False)]
)
def test_images_of_obj_files_are_kept_or_reported(content: bytes, kept: bool, tmp_path: Path) -> None:
    surface = Surface([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2]])
    materials = (Material("Red", (1, 0, 0, 1), content),)
    asset = Asset(surface, (material_numbers(np.zeros(1, dtype=int)),), materials)
    assert write_asset(asset, tmp_path / "a.obj") == ()
    assert read_asset(tmp_path / "a.obj").materials == materials
    notes = write_asset(asset, tmp_path / "a.glb")
    again = read_asset(tmp_path / "a.glb")
    kind = image_type(content)
    assert kind is not None
    if kept:
        assert notes == again.notes == ()
        assert again.materials[0].image == content
        assert tree_of(tmp_path / "a.glb")["images"][0]["mimeType"] == kind.mime
    else:
        assert notes == (
            "The image of the material 'Red' is of a type that glTF cannot store, and was left out: convert it to PNG.",
        )
        assert again.materials[0].image is None
        assert "images" not in tree_of(tmp_path / "a.glb")


def test_other_content_has_no_image_type() -> None:
    for content in (b"", b"root:x:0:0:", b"password", bytes(100), b"RIFF", b"solid a"):
        assert image_type(content) is None


def test_missing_image_does_not_affect_the_others(tmp_path: Path) -> None:
    path = write_textured(tmp_path, {"a.png": PNG, "b.png": PNG}, {"source": 1})
    (tmp_path / "a.png").unlink()
    asset = read_asset(path)
    assert asset.notes == ()  # no material shows it
    assert asset.materials[0].image == PNG
    (note,) = write_asset(asset, tmp_path / "again.glb")
    assert note.startswith("The image 'a.png' could not be opened")
    tree = tree_of(tmp_path / "again.glb")
    assert len(tree["images"]) == 1
    assert tree["textures"] == [{"source": 0}]


VARIANTS = "KHR_materials_variants"


def with_variants(path: Path, mappings: list[Any], materials: list[int]) -> None:
    """Write a tube of several parts with materials and, for each, the mappings of variants."""
    write_tube(path, parts=len(mappings))
    tree, binary = parse_gltf(path.read_bytes())
    tree["extensionsUsed"], tree["extensions"] = [VARIANTS], {VARIANTS: {"variants": [{"name": "dark"}]}}
    for primitive, mapping, material in zip(tree["meshes"][0]["primitives"], mappings, materials, strict=True):
        primitive["material"] = material
        if mapping is not None:
            primitive["extensions"] = {VARIANTS: {"mappings": [{"material": mapping, "variants": [0]}]}}
    tree["meshes"][0]["extras"]["maker"] = "me"
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + len(binary).to_bytes(4, "little") + b"BIN\0" + binary
    path.write_bytes(b"glTF\x02\0\0\0" + (12 + len(chunks)).to_bytes(4, "little") + chunks)


def test_material_variants_and_extras_are_kept(tmp_path: Path) -> None:
    with_variants(tmp_path / "a.glb", [1, None], [0, 1])
    asset = read_asset(tmp_path / "a.glb")
    assert write_asset(asset, tmp_path / "b.glb") == ()
    tree = tree_of(tmp_path / "b.glb")
    found = {each["material"]: each.get("extensions") for each in tree["meshes"][0]["primitives"]}
    assert found == {0: {VARIANTS: {"mappings": [{"material": 1, "variants": [0]}]}}, 1: None}
    assert tree["meshes"][0]["extras"] == {"maker": "me", "targetNames": ["Lean"]}
    assert tree["asset"]["generator"] == f"ZoomOut Transfer {package_version()}"


def test_variants_that_differ_within_a_material_are_reported(tmp_path: Path) -> None:
    with_variants(tmp_path / "a.glb", [1, None], [0, 0])
    (note,) = write_asset(read_asset(tmp_path / "a.glb"), tmp_path / "b.glb")
    assert note.startswith("Some parts with the same material have different material variants")


def test_variants_are_dropped_if_materials_are_replaced(tmp_path: Path) -> None:
    with_variants(tmp_path / "a.glb", [1, None], [0, 1])
    asset = replace(read_asset(tmp_path / "a.glb"), materials=(Material("A"), Material("B")))
    assert write_asset(asset, tmp_path / "b.glb") == ()
    tree = tree_of(tmp_path / "b.glb")
    assert VARIANTS not in json.dumps(tree)


def test_extras_of_primitives_are_kept_unless_joined(tmp_path: Path) -> None:
    for name, materials in (("a", [0, 1]), ("b", [0, 0])):
        with_variants(tmp_path / f"{name}.glb", [1, 1], materials)
        asset = read_asset(tmp_path / f"{name}.glb")
        assert asset.document is not None
        asset.document.gltf.meshes[0].primitives[1].extras = {"part": 2}
        notes = write_asset(asset, tmp_path / f"{name} again.glb")
        (mesh,) = tree_of(tmp_path / f"{name} again.glb")["meshes"]
        assert mesh["extras"] == {"maker": "me", "targetNames": ["Lean"]}
        kept = [each.get("extras") for each in mesh["primitives"]]
        if name == "a":
            assert notes == ()
            assert kept == [None, {"part": 2}]
        else:
            assert notes[0].startswith("The meshes have free data (extras) of their own")
            assert kept == [None]


def test_gpu_instances_stay_with_their_mesh(tmp_path: Path) -> None:
    path = write_textured(tmp_path, {"a.png": PNG}, {"source": 0})
    tree = json.loads(path.read_text())
    (node,) = [node for node in tree["nodes"] if "mesh" in node]
    node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}
    path.write_text(json.dumps(tree))
    asset = read_asset(path)
    assert asset.notes == (
        "tube.gltf contains copies of meshes (EXT_mesh_gpu_instancing), of which only the original is read.",
    )
    assert write_asset(asset, tmp_path / "b.glb") == ()
    assert asset.document is not None
    again = Document(tmp_path / "b.glb")
    (copies,) = [node.extensions["EXT_mesh_gpu_instancing"] for node in again.gltf.nodes if node.extensions]
    np.testing.assert_array_equal(again.array(copies["attributes"]["TRANSLATION"]), asset.document.array(0))
    assert "EXT_mesh_gpu_instancing" in again.gltf.extensionsUsed
    # Another surface has no copies.
    notes = write_asset(replace(asset, nodes=()), tmp_path / "c.glb")
    assert notes == ("Copies of meshes (EXT_mesh_gpu_instancing) were left out, because the mesh was replaced.",)
    assert "EXT_mesh_gpu_instancing" not in json.dumps(tree_of(tmp_path / "c.glb"))
