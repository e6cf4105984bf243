# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes, joints and materials are added to an avatar without changing its other data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skinned_tubes import PNG
from vrm_files import BONES, FACE, HAIR, replace_tree, tree_of, write_avatar
from vrm_validator import faults

from zoomout_core.assets.asset import SHAPE_KEYS, Asset, Skin
from zoomout_core.assets.files import read_asset
from zoomout_core.assets.gltf.append import NewJoint, append_to_gltf
from zoomout_core.assets.gltf.springs import Partner
from zoomout_core.mesh.formats.gltf_document import Document
from zoomout_core.outfits.parts import keep_faces
from zoomout_core.transfer.attribute import Attribute, Domain, Kind


@pytest.fixture(params=[0, 1])
def version(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture
def path(version: int, tmp_path: Path) -> Path:
    write_avatar(tmp_path / "avatar.vrm", version)
    return tmp_path / "avatar.vrm"


def hat_of(asset: Asset, skin: Skin | None = None) -> Asset:
    """The hat of an avatar, the first of its meshes."""
    worn = keep_faces(asset, asset.surface.face_start[1:] <= 3 * (asset.surface.triangles < 40).all(axis=1).sum())
    assert [name for name, _ in worn.objects] == ["Hat"]
    return replace(worn, skin=skin, attributes=tuple(each for each in worn.attributes if each.name != SHAPE_KEYS))


def with_key(asset: Asset, name: str) -> Asset:
    """An asset with a key that raises it."""
    offsets = np.tile([[[0, 0.01, 0]]], (len(asset.surface.vertices), 1, 1))
    return replace(
        asset, attributes=(*asset.attributes, Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, offsets, (name,)))
    )


def test_avatar_keeps_all_of_its_own_data(path: Path, version: int, tmp_path: Path) -> None:
    before, document = tree_of(path), Document(path)
    assert append_to_gltf(document, (), hat_of(read_asset(path)), tmp_path / "out.vrm") == ()
    assert faults(tmp_path / "out.vrm") == []
    after, written = tree_of(tmp_path / "out.vrm"), Document(tmp_path / "out.vrm")
    for table in ("accessors", "animations", "images", "materials", "meshes", "nodes", "skins", "textures"):
        assert after[table][: len(before[table])] == before[table]
    assert {name: after["extensions"][name] for name in before["extensions"] if name != "VRM"} == {
        name: each for name, each in before["extensions"].items() if name != "VRM"
    }
    for number in range(len(before["bufferViews"])):
        assert written.view(number) == document.view(number)
    assert [len(after[table]) - len(before[table]) for table in ("materials", "textures", "images", "meshes")] == [
        1
    ] * 4
    material = after["materials"][-1]
    assert material["name"] == "Felt 2"
    assert written.image_of(material["pbrMetallicRoughness"]["baseColorTexture"]["index"]) == PNG
    if version == 0:
        described = after["extensions"]["VRM"]["materialProperties"]
        assert [each["name"] for each in described] == [each["name"] for each in after["materials"]]
        assert described[-1]["shader"] == "VRM/MToon"
        assert described[-1]["textureProperties"]["_MainTex"] == len(after["textures"]) - 1
    else:
        shade = material["extensions"]["VRMC_materials_mtoon"]["shadeMultiplyTexture"]
        assert shade["index"] == len(after["textures"]) - 1


def test_images_with_the_same_content_share_it(path: Path, tmp_path: Path) -> None:
    """Outfits often use textures of the avatar."""
    append_to_gltf(Document(path), (), hat_of(read_asset(path)), tmp_path / "out.vrm")
    images = tree_of(tmp_path / "out.vrm")["images"]
    assert len(images) == len(tree_of(path)["images"]) + 1
    assert len({image["bufferView"] for image in images}) == 1


def test_added_mesh_keeps_its_place_and_weights(path: Path, tmp_path: Path) -> None:
    asset = read_asset(path)
    assert asset.skin is not None
    hat = hat_of(asset)
    own = replace(
        asset.skin,
        rest=hat.surface.vertices,
        linear=np.tile(np.eye(3), (40, 1, 1)),
        weights=asset.skin.weights[:40],
    )
    append_to_gltf(Document(path), (), replace(hat, skin=own), tmp_path / "out.vrm")
    assert faults(tmp_path / "out.vrm") == []
    again = read_asset(tmp_path / "out.vrm")
    assert again.objects[-1] == ("Hat", 40)
    np.testing.assert_allclose(again.surface.vertices[-40:], hat.surface.vertices, atol=1e-6)
    assert again.skin is not None
    assert abs(again.skin.weights[-40:] - asset.skin.weights[:40]).max() < 1e-6


def test_added_joints_are_parented_to_those_of_the_avatar(path: Path, tmp_path: Path) -> None:
    document = Document(path)
    step = np.eye(4)
    step[1, 3] = 0.25
    joints = (NewJoint("Feather", 5, step), NewJoint("Tip", len(document.gltf.nodes), step))
    append_to_gltf(document, joints, hat_of(read_asset(path)), tmp_path / "out.vrm")
    assert faults(tmp_path / "out.vrm") == []
    written = Document(tmp_path / "out.vrm")
    worlds = written.worlds()[0]
    first = len(document.gltf.nodes)
    assert [node.name for node in written.gltf.nodes[first:]] == ["Feather", "Tip", "Hat"]
    np.testing.assert_allclose(worlds[first + 1, :3, 3], document.worlds()[0][5, :3, 3] + [0, 0.5, 0])


def test_expressions_bind_added_keys_of_their_names(path: Path, version: int, tmp_path: Path) -> None:
    append_to_gltf(Document(path), (), with_key(hat_of(read_asset(path)), "Fcl_A"), tmp_path / "out.vrm")
    assert faults(tmp_path / "out.vrm") == []
    tree = tree_of(tmp_path / "out.vrm")
    if version == 0:
        groups = tree["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"]
        binds = {group["name"]: [(each["mesh"], each["index"]) for each in group["binds"]] for group in groups}
        assert binds["A"] == [(1, 1), (3, 0)]
        assert binds["Blink"] == [(1, 0)]
    else:
        presets = tree["extensions"]["VRMC_vrm"]["expressions"]["preset"]
        binds = {
            name: [(bind["node"], bind["index"]) for bind in each["morphTargetBinds"]] for name, each in presets.items()
        }
        assert binds["aa"] == [(FACE, 1), (len(tree["nodes"]) - 1, 0)]
        assert binds["blink"] == [(FACE, 0)]


def test_shader_of_another_vrm_version_is_reported(version: int, path: Path, tmp_path: Path) -> None:
    write_avatar(tmp_path / "other.vrm", 1 - version)
    notes = append_to_gltf(Document(path), (), hat_of(read_asset(tmp_path / "other.vrm")), tmp_path / "out.vrm")
    assert faults(tmp_path / "out.vrm") == []
    shader = "The shader of the material Felt 2 is that of VRM 0, and was left out."
    assert notes == ((shader,) if version == 1 else ())


def test_unreadable_texture_is_left_out(path: Path, tmp_path: Path) -> None:
    tree = tree_of(path)
    tree["images"][0] = {"uri": "missing.png"}
    (tmp_path / "hats").mkdir()
    other = tmp_path / "hats" / "hat.vrm"
    other.write_bytes(path.read_bytes())
    replace_tree(other, tree)
    notes = append_to_gltf(Document(path), (), hat_of(read_asset(other)), tmp_path / "out.vrm")
    assert faults(tmp_path / "out.vrm") == []
    assert notes == ()  # it was reported when it was read
    assert "baseColorTexture" not in tree_of(tmp_path / "out.vrm")["materials"][-1]["pbrMetallicRoughness"]


def springs_of(tree: dict[str, Any]) -> list[tuple[list[int], list[int]]]:
    """The nodes that each chain lists, and those of its colliders."""
    if "VRM" in tree["extensions"]:
        animation = tree["extensions"]["VRM"]["secondaryAnimation"]
        groups = [each["node"] for each in animation["colliderGroups"]]
        return [
            (each["bones"], [groups[group] for group in each["colliderGroups"]]) for each in animation["boneGroups"]
        ]
    given = tree["extensions"]["VRMC_springBone"]
    groups = [given["colliders"][each["colliders"][0]]["node"] for each in given["colliderGroups"]]
    return [
        ([joint["node"] for joint in each["joints"]], [groups[group] for group in each.get("colliderGroups", ())])
        for each in given["springs"]
    ]


def test_springs_of_added_joints_are_kept(path: Path, version: int, tmp_path: Path) -> None:
    document = Document(path)
    first, head = len(document.gltf.nodes), 1 + list(BONES).index("head")
    joints = [NewJoint(f"Hair {at}", first + at - 1 if at else head, np.eye(4), HAIR + at) for at in range(3)]
    append_to_gltf(document, joints, hat_of(read_asset(path)), tmp_path / "out.vrm", {head: Partner(head)})
    assert faults(tmp_path / "out.vrm") == []
    before, after = (springs_of(tree_of(each)) for each in (path, tmp_path / "out.vrm"))
    assert after[: len(before)] == before
    assert after[len(before) :] == [([first] if version == 0 else [first, first + 1, first + 2], [head])]
    # Without a partner of the head, the chain has no collider.
    append_to_gltf(document, joints, hat_of(read_asset(path)), tmp_path / "free.vrm")
    assert faults(tmp_path / "free.vrm") == []
    assert springs_of(tree_of(tmp_path / "free.vrm"))[-1][1] == []
