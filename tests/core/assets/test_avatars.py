# SPDX-License-Identifier: GPL-3.0-or-later
"""VRM files stay valid: meshes keep their nodes, and references to nodes, meshes, morph targets and materials hold."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from skinned_tubes import write_tube
from vrm_files import (
    BODY,
    BONES,
    FACE,
    HAIR,
    HAT,
    HAT_SHAPE,
    body,
    face,
    face_keys,
    replace_tree,
    tree_of,
    write_avatar,
)
from vrm_validator import faults

from zoomout_core.assets.asset import SHAPE_KEYS, Asset, Material, material_numbers
from zoomout_core.assets.files import inputs_of, read_asset, write_asset
from zoomout_core.assets.gltf.avatars import Avatar, read_avatar
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.cli import main
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.formats.gltf_document import Document
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

VERSIONS = (0, 1)


@pytest.fixture(params=VERSIONS, ids=["VRM 0", "VRM 1"])
def version(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture
def path(tmp_path: Path, version: int) -> Path:
    """The file of an avatar."""
    write_avatar(tmp_path / "doll.vrm", version)
    return tmp_path / "doll.vrm"


def onto(source: Surface, target: Surface) -> Any:
    """A match of a target's vertices to their closest points on a source, with full confidence."""
    surface_map = SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles)
    return SimpleNamespace(surface_map=surface_map, confidence=np.ones(len(target.vertices)), has_partner=None)


def with_keys(surface: Surface, offsets: dict[str, np.ndarray]) -> Asset:
    """A surface with shape keys (n, 3)."""
    values = np.stack(list(offsets.values()), axis=1)
    return Asset(surface, (Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, values, tuple(offsets)),))


def expressions(tree: dict[str, Any]) -> dict[str, list[tuple[int, int, float]]]:
    """The binds of each expression: mesh, morph target and share."""
    if "VRM" in tree["extensions"]:
        groups = tree["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"]
        return {
            each["name"]: [(bind["mesh"], bind["index"], bind["weight"] / 100) for bind in each["binds"]]
            for each in groups
        }
    given = tree["extensions"]["VRMC_vrm"]["expressions"]
    return {
        name: [
            (tree["nodes"][bind["node"]]["mesh"], bind["index"], bind["weight"])
            for bind in each.get("morphTargetBinds", ())
        ]
        for name, each in (given.get("preset", {}) | given.get("custom", {})).items()
    }


def write_valid(asset: Asset, path: Path) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The JSON of a written file without faults, and the notes."""
    notes = write_asset(asset, path)
    assert faults(path) == []
    return tree_of(path), notes


def test_avatar_round_trip_keeps_all_tables(path: Path) -> None:
    before, asset = tree_of(path), read_asset(path)
    assert asset.notes == ()
    assert faults(path) == []
    after, notes = write_valid(asset, path.with_name("again.vrm"))
    assert notes == ()
    for table in ("extensions", "extensionsUsed", "materials", "nodes", "scenes", "textures"):
        assert after[table] == before[table]
    for mesh, old in zip(after["meshes"], before["meshes"], strict=True):
        assert mesh["name"] == old["name"]
        assert [each["material"] for each in mesh["primitives"]] == [each["material"] for each in old["primitives"]]
    assert after["meshes"][1]["weights"] == [0, 0.25]
    assert after["meshes"][1]["extras"] == {"maker": "me", "targetNames": ["Fcl_Blink", "Fcl_A"]}
    for skin, old in zip(after["skins"], before["skins"], strict=True):
        assert {**skin, "inverseBindMatrices": None} == {**old, "inverseBindMatrices": None}


def test_meshes_keep_their_shapes_and_nodes(path: Path) -> None:
    asset = read_asset(path)
    write_asset(asset, path.with_name("again.vrm"))
    again = read_asset(path.with_name("again.vrm"))
    assert again.objects == asset.objects == (("Hat", 40), ("Body", 120), ("Face", 90))
    assert again.nodes == asset.nodes == (HAT, BODY, FACE)
    assert again.skin is not None
    assert again.skin.names == ("J_hips", "J_spine", "J_chest", "J_head", "J_leftEye")
    hat, skinned = slice(0, 40), slice(40, None)
    np.testing.assert_allclose(again.surface.vertices[skinned], again.skin.rest[skinned], atol=1e-6)
    for part, shape in ((slice(40, 160), body()), (slice(160, None), face())):
        assert np.linalg.norm(again.surface.vertices[part][:, None] - shape.vertices, axis=2).min(axis=1).max() < 1e-6
    # The hat is in the frame of its mirrored node, and its faces look outwards.
    own = Document(path.with_name("again.vrm"))
    primitive = own.gltf.meshes[2].primitives[0]
    positions = own.array(primitive.attributes.POSITION)
    assert np.linalg.norm(positions[:, None] - HAT_SHAPE.vertices, axis=2).min(axis=1).max() < 1e-6
    assert np.einsum("nx,nx->n", own.array(primitive.attributes.NORMAL), positions - [0, 0.1, 0]).min() > 0
    seen = again.surface.vertices[hat]
    assert np.linalg.norm(seen - asset.surface.vertices[hat], axis=1).max() < 1e-6
    for shown in (asset, again):
        corners = shown.surface.vertices[shown.surface.triangles]
        corners = corners[(shown.surface.triangles < 40).all(axis=1)] - seen.mean(axis=0)
        assert np.linalg.det(corners).sum() > 0


def test_surface_of_an_avatar_equals_that_of_its_asset(path: Path) -> None:
    np.testing.assert_array_equal(read_surface(path).vertices, read_asset(path).surface.vertices)


def test_new_shape_keys_are_appended_to_those_of_the_avatar(path: Path) -> None:
    target = read_asset(path)
    on_face = (np.arange(len(target.surface.vertices)) >= 160)[:, None]
    source = with_keys(
        target.surface,
        {
            "Wink": np.where(on_face, [0.0, 0, 0.01], 0),
            "Fcl_A": np.where(on_face, 2 * face_keys(target.surface.vertices)["Fcl_A"], 0),
        },
    )
    carried = transfer_asset(source, target, onto(source.surface, target.surface), [SHAPE_KEYS])
    tree, notes = write_valid(carried.asset, path.with_name("out.vrm"))
    assert notes == ()
    assert tree["meshes"][1]["extras"]["targetNames"] == ["Fcl_Blink", "Fcl_A", "Wink"]
    assert tree["meshes"][1]["weights"] == [0, 0.25, 0]
    assert "targetNames" not in tree["meshes"][0].get("extras", {})  # which it does not move
    assert expressions(tree) == expressions(tree_of(path))
    again = read_asset(path.with_name("out.vrm")).find(SHAPE_KEYS)
    was = target.find(SHAPE_KEYS)
    assert again is not None
    assert was is not None
    own = slice(160, None)
    height = [np.abs(each.values[own, at, 1]).max() for each, at in ((was, 0), (again, 0), (was, 1), (again, 1))]
    np.testing.assert_allclose(height, [0.02, 0.02, 0.01, 0.02], rtol=0.2)
    # The animation moves no morph target that it did not know.
    document = Document(path.with_name("out.vrm"))
    weights = document.array(document.gltf.animations[0].samplers[0].output).reshape(2, 3)
    np.testing.assert_allclose(weights, [[0, 0.5, 0], [1, 0.25, 0]])


def test_keys_named_like_presets_become_expressions(path: Path, version: int) -> None:
    target = read_asset(path)
    move = np.where(target.surface.vertices[:, 1:2] > 1.5, [0.0, 0, 0.01], 0)
    fresh, known, empty = ("O", "blink", "joy") if version == 0 else ("oh", "blink", "happy")
    source = with_keys(target.surface, dict.fromkeys((fresh, known, empty), move))
    carried = transfer_asset(source, target, onto(source.surface, target.surface), [SHAPE_KEYS])
    tree, notes = write_valid(carried.asset, path.with_name("out.vrm"))
    assert len(notes) == 1
    assert notes[0].startswith("Expressions were made of the shape keys of their names:")
    found, before = expressions(tree), expressions(tree_of(path))
    names = {name.lower(): name for name in found}
    assert [each[:2] for each in found[names[fresh.lower()]] if each[0] == 1] == [(1, 2)]
    assert [each[:2] for each in found[names[empty]] if each[0] == 1] == [(1, 4)]
    assert found[names[known]] == before[names[known]]  # it was an expression already


def test_avatar_bones_are_kept_on_another_body(path: Path, version: int) -> None:
    source = read_asset(path)
    scan = ball(0.3, (0, 1.2, 0), (1, 2, 0.7), count=300, seed=5)
    carried = transfer_asset(source, Asset(scan), onto(source.surface, scan), shape="keep shape")
    tree, notes = write_valid(carried.asset, path.with_name("scan.vrm"))
    assert notes[0].startswith("The meshes have free data (extras) of their own, which was left out")
    assert notes[1:] == (
        "The display in first person is chosen by the bones, because meshes that differ in it were joined.",
    )
    assert [number for number, node in enumerate(tree["nodes"]) if "mesh" in node] == [BODY]
    assert len(tree["nodes"]) == len(tree_of(path)["nodes"])
    assert tree["meshes"][0]["extras"]["targetNames"] == ["Fcl_Blink", "Fcl_A"]
    before = expressions(tree_of(path))
    assert expressions(tree) == {name: [(0, at, share) for _, at, share in each] for name, each in before.items()}
    view = tree["extensions"]["VRM" if version == 0 else "VRMC_vrm"]["firstPerson"]["meshAnnotations"]
    assert view == [{"mesh": 0, "firstPersonFlag": "Auto"} if version == 0 else {"node": BODY, "type": "auto"}]
    assert tree["animations"][0]["channels"][0]["target"]["node"] == BODY
    assert tree["materials"] == tree_of(path)["materials"]


def test_expressions_without_morph_targets_are_dropped_and_reported(path: Path) -> None:
    source = read_asset(path)
    scan = ball(0.3, (0, 1.2, 0), (1, 2, 0.7), count=300, seed=5)
    carried = transfer_asset(source, Asset(scan), onto(source.surface, scan), ["weights", "materials"], "keep shape")
    tree, notes = write_valid(carried.asset, path.with_name("scan.vrm"))
    lost = [note for note in notes if note.startswith("Expressions were left out, because their morph targets")]
    assert len(lost) == 1
    assert "'blink'" in lost[0].lower()
    left = expressions(tree)
    assert {name.lower() for name in left} in ({"joy", "pale"}, {"happy", "pale"})
    assert "animations" not in tree
    assert any(note.startswith("Animations of materials or morph targets that are gone") for note in notes)


def test_replacing_materials_keeps_the_rest_of_the_avatar(path: Path, version: int) -> None:
    target = read_asset(path)
    count = len(target.surface.face_start) - 1
    numbers = material_numbers(np.arange(count) % 2)
    source = Asset(target.surface, (numbers,), (Material("Mouth", (1, 0, 0, 1)), Material("Gold", (1, 1, 0, 1))))
    carried = transfer_asset(source, target, onto(source.surface, target.surface), ["materials"])
    tree, notes = write_valid(carried.asset, path.with_name("out.vrm"))
    assert [each["name"] for each in tree["materials"]] == ["Mouth", "Gold"]
    assert [node.get("mesh") for node in tree["nodes"]] == [node.get("mesh") for node in tree_of(path)["nodes"]]
    (note,) = notes
    if version == 0:
        assert note == "Expressions were left out, because their morph targets or materials are gone: 'Pale'."
        shaders = [each["shader"] for each in tree["extensions"]["VRM"]["materialProperties"]]
        assert shaders == ["VRM_USE_GLTFSHADER"] * 2
        thumbnail = tree["textures"][tree["extensions"]["VRM"]["meta"]["texture"]]["source"]
    else:
        assert note == "Expressions were reduced, because their morph targets or materials are gone: 'Pale'."
        pale = tree["extensions"]["VRMC_vrm"]["expressions"]["custom"]["Pale"]
        assert pale["materialColorBinds"] == []
        assert [each["material"] for each in pale["textureTransformBinds"]] == [0]
        thumbnail = tree["extensions"]["VRMC_vrm"]["meta"]["thumbnailImage"]
    document = Document(path.with_name("out.vrm"))
    assert document.image(thumbnail) == Document(path).image(1)


def test_materials_of_another_avatar_are_copied_in_full(tmp_path: Path, path: Path, version: int) -> None:
    write_avatar(tmp_path / "other.vrm", version)
    target, source = read_asset(path), read_asset(tmp_path / "other.vrm")
    carried = transfer_asset(source, target, onto(source.surface, target.surface), ["materials"])
    tree, notes = write_valid(carried.asset, path.with_name("out.vrm"))
    before = tree_of(path)
    assert notes == ()
    assert tree["materials"] == before["materials"]
    assert tree["extensionsUsed"] == before["extensionsUsed"]
    if version == 0:
        assert tree["extensions"]["VRM"]["materialProperties"] == before["extensions"]["VRM"]["materialProperties"]
    else:
        assert tree["extensions"]["VRMC_vrm"]["expressions"] == before["extensions"]["VRMC_vrm"]["expressions"]


def test_mesh_on_two_nodes_becomes_two_meshes(path: Path) -> None:
    tree = tree_of(path)
    tree["nodes"].append({"name": "Mask", "mesh": 1, "skin": 1})
    tree["nodes"][0]["children"].append(len(tree["nodes"]) - 1)
    replace_tree(path, tree)
    made, notes = write_valid(read_asset(path), path.with_name("out.vrm"))
    assert notes == ()
    assert [made["nodes"][node]["mesh"] for node in (BODY, FACE, -1, HAT)] == [0, 1, 2, 3]
    before = expressions(tree)
    both = {0: [0], 1: [1, 2], 2: [3]} if "VRM" in tree["extensions"] else {0: [0], 1: [1], 2: [3]}
    assert expressions(made) == {
        name: [(new, at, share) for old, at, share in each for new in both[old]] for name, each in before.items()
    }


def test_morph_targets_of_equal_names_stay_distinct(path: Path) -> None:
    tree = tree_of(path)
    for part in (tree["meshes"][1], *tree["meshes"][1]["primitives"]):
        if "targetNames" in part.get("extras", {}):
            part["extras"]["targetNames"] = ["Smile", "Smile"]
    replace_tree(path, tree)
    asset = read_asset(path)
    keys = asset.find(SHAPE_KEYS)
    assert keys is not None
    assert keys.labels == ("Smile", "Smile 2")
    made, _ = write_valid(asset, path.with_name("out.vrm"))
    assert expressions(made) == expressions(tree)


def test_file_without_avatar_bones_cannot_become_vrm(tmp_path: Path, path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    tube, target = read_asset(tmp_path / "tube.glb"), read_asset(path)
    with pytest.raises(MeshError, match="would not be an avatar, because its joints are not those of a VRM file"):
        write_asset(tube, tmp_path / "out.vrm")
    carried = transfer_asset(tube, target, onto(tube.surface, target.surface), ["weights"])
    with pytest.raises(MeshError, match=r"leave out the skin weights if the target is an avatar, or write a \.glb"):
        write_asset(carried.asset, tmp_path / "out.vrm")
    assert not (tmp_path / "out.vrm").exists()
    write_asset(transfer_asset(tube, target, onto(tube.surface, target.surface), ["uv"]).asset, tmp_path / "out.vrm")
    assert faults(tmp_path / "out.vrm") == []


def test_images_outside_the_folder_of_an_avatar_are_not_read(tmp_path: Path, path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    (tmp_path / "secret.png").write_bytes(Document(path).image(0) or b"")
    tree = tree_of(path)
    tree["images"] = [{"uri": "../secret.png"}, {"uri": "%2e%2e/secret.png"}]
    replace_tree(path, tree)
    moved = path.rename(folder / "doll.vrm")
    asset = read_asset(moved)
    assert any("'../secret.png' is outside the folder of the file" in note for note in asset.notes)
    assert [each.name for each in inputs_of(moved)] == ["doll.vrm", "secret.png", "secret.png"]
    made, _ = write_valid(asset, tmp_path / "out.vrm")
    assert "images" not in made
    assert "thumbnailImage" not in json.dumps(made)
    assert read_asset(moved, [tmp_path]).notes == ()


def test_avatar_metadata_is_read(path: Path, version: int) -> None:
    avatar = read_avatar(read_asset(path).document)
    assert avatar is not None
    assert avatar.version == ("0.0", "1.0")[version]
    assert avatar.title == "Doll"
    assert avatar.authors == (("me",), ("me", "you"))[version]
    assert avatar.bones == {name: f"J_{name}" for name in BONES}
    if version == 0:
        assert avatar.licence == {"licenseName": "CC0"}
        assert avatar.expressions == ("Blink", "A", "Joy", "Pale")
        assert avatar.springs == (("Hair1", 3),)
    else:
        assert avatar.licence["modification"] == "allowModification"
        # Uses that the file does not mention are not allowed.
        allowed = {name: value for name, value in avatar.licence.items() if name.startswith("allow")}
        assert list(allowed.values()) == [False] * 5
        assert avatar.licence["avatarPermission"] == "onlyAuthor"
        assert avatar.expressions == ("blink", "aa", "happy", "Pale")
        assert avatar.springs == (("Hair", 3),)


@pytest.mark.parametrize(
    ("made_with", "bones"),
    [
        ("0.0", ("leftHand", "leftThumbProximal", "leftThumbIntermediate", "leftThumbDistal", "leftIndexProximal")),
        ("1.0", ("leftHand", "leftThumbMetacarpal", "leftThumbProximal", "leftThumbDistal", "leftIndexProximal")),
    ],
)
def test_thumbs_are_the_same_humanoid_bones_in_both_versions(made_with: str, bones: tuple[str, ...]) -> None:
    avatar = Avatar(made_with, "", (), {}, dict(zip(bones, "habci", strict=True)), (), ())
    hand = ("leftHand", "leftThumbMetacarpal", "leftThumbProximal", "leftThumbDistal", "leftIndexProximal")
    assert avatar.humanoid == dict(zip(hand, "habci", strict=True))


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, [*map(str, arguments)])
    return result.exit_code, result.stdout + (result.stderr if result.exit_code else "")


def test_info_command_reports_avatar_metadata(path: Path, version: int) -> None:
    code, said = run("info", path)
    assert code == 0
    title = ("Avatar of VRM 0.0: Doll by me.", "Avatar of VRM 1.0: Doll by me, you.")[version]
    terms = ("licenseName CC0", "modification allowModification")[version]
    for sentence in (
        title,
        terms,
        "Humanoid bones (18): hips (J_hips), ",
        "Expressions (4): ",
        "Spring chains (1): Hair",
    ):
        assert sentence in said
    avatar = json.loads(run("info", path, "--json")[1])["avatar"]
    assert avatar["bones"]["head"] == "J_head"
    assert avatar["springs"] == [[("Hair1", "Hair")[version], 3]]


@pytest.mark.usefixtures("remember_matches")
def test_transfer_command_writes_an_avatar(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("source.vrm", "target.vrm", "out.vrm")]
    for file in files[:2]:
        write_avatar(file, 1)
    options = "--kinds", "uv,shape-keys", "--detail", "fast", "--cache", "off"
    code, said = run("transfer", *files[:2], "-o", files[2], *options)
    assert code == 0, said
    assert faults(files[2]) == []
    assert tree_of(files[2])["nodes"] == tree_of(files[1])["nodes"]


def test_transfer_command_refuses_invalid_avatar_before_matching(path: Path, tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    code, said = run("transfer", tmp_path / "tube.glb", path, "-o", tmp_path / "out.vrm", "--cache", "off")
    assert code == 1
    assert "leave out the skin weights if the target is an avatar" in said
    assert not (tmp_path / "out.vrm").exists()


def entries_of(part: Any) -> Iterator[tuple[Any, Any]]:
    """Every value in a tree, as its container and its key there."""
    for key in list(part) if isinstance(part, dict) else range(len(part)) if isinstance(part, list) else ():
        yield part, key
        yield from entries_of(part[key])


def test_malformed_extensions_raise_no_error(path: Path) -> None:
    asset = read_asset(path)
    assert asset.document is not None
    whole = deepcopy(asset.document.gltf.extensions)
    random = np.random.default_rng(0)
    for number in range(10):
        changed = deepcopy(whole)
        for _ in range(8):
            every = list(entries_of(changed))
            container, key = every[random.integers(len(every))]
            container[key] = (-1, 10**9, "text", [], {}, [None], True, 0.5, [[1]])[random.integers(9)]
        asset.document.gltf.extensions = changed
        read_avatar(asset.document)
        write_asset(asset if number % 2 else replace(asset, nodes=()), path.with_name("out.glb"))
        read_asset(path.with_name("out.glb"))


Break = Callable[[dict[str, Any]], object]
BROKEN: dict[int, dict[str, Break]] = {
    0: {
        "meshes of Blink": lambda vrm: vrm["blendShapeMaster"]["blendShapeGroups"][0]["binds"][0].update(mesh=9),
        "morph targets of Blink": lambda vrm: vrm["blendShapeMaster"]["blendShapeGroups"][0]["binds"][0].update(mesh=0),
        "the bone neck is missing": lambda vrm: vrm["humanoid"]["humanBones"].pop(3),
        "is not below its parent": lambda vrm: vrm["humanoid"]["humanBones"][4].update(node=HAIR - HAIR),
        "properties of 3 materials": lambda vrm: vrm["materialProperties"].pop(),
        "annotations": lambda vrm: vrm["firstPerson"]["meshAnnotations"][0].update(mesh=3),
        "thumbnail": lambda vrm: vrm["meta"].update(texture=2),
        "springs": lambda vrm: vrm["secondaryAnimation"]["boneGroups"][0].update(bones=[99]),
    },
    1: {
        "morph targets of blink": lambda vrm: vrm["expressions"]["preset"]["blink"]["morphTargetBinds"][0].update(
            node=1
        ),
        "the bone hips is missing": lambda vrm: vrm["humanoid"]["humanBones"].pop("hips"),
        "is no preset": lambda vrm: vrm["expressions"]["preset"].update(joy={}),
        "has no mesh": lambda vrm: vrm["firstPerson"]["meshAnnotations"][0].update(node=1),
        "thumbnail": lambda vrm: vrm["meta"].update(thumbnailImage=2),
        "materials of Pale": lambda vrm: vrm["expressions"]["custom"]["Pale"]["materialColorBinds"][0].update(
            material=3
        ),
    },
}


@pytest.mark.parametrize(("number", "fault"), [(number, fault) for number, each in BROKEN.items() for fault in each])
def test_the_validator_finds_faults(tmp_path: Path, number: int, fault: str) -> None:
    write_avatar(tmp_path / "doll.vrm", number)
    tree = tree_of(tmp_path / "doll.vrm")
    BROKEN[number][fault](tree["extensions"][("VRM", "VRMC_vrm")[number]])
    replace_tree(tmp_path / "doll.vrm", tree)
    assert any(fault in found for found in faults(tmp_path / "doll.vrm"))
