# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of a glTF file keep their nodes, and references to nodes, meshes and morph targets stay valid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
import pytest
from scipy.spatial.transform import Rotation
from vrm_files import BODY, FACE, HAT, replace_tree, tree_of, write_avatar

from zoomout_core.assets.asset import SHAPE_KEYS, Asset, Material
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_buffer import Buffer
from zoomout_core.mesh.formats.gltf_document import Document
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

POINTER = "KHR_animation_pointer"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file with a skinned body and face, and a hat that is parented to the head."""
    write_avatar(tmp_path / "doll.glb", 1)
    tree = tree_of(tmp_path / "doll.glb")
    del tree["extensions"]
    replace_tree(tmp_path / "doll.glb", tree)
    return tmp_path / "doll.glb"


def read_with_tables(path: Path, **tables: Any) -> Asset:
    """The asset of a file after tables of its JSON were replaced."""
    replace_tree(path, tree_of(path) | tables)
    return read_asset(path)


def with_key_first(asset: Asset) -> Asset:
    """The asset with one more shape key in front, which moves the face and the body."""
    keys = asset.find(SHAPE_KEYS)
    assert keys is not None
    values = np.concatenate([np.zeros_like(keys.values[:, :1]), keys.values], axis=1)
    values[40:, 0, 2] = 0.01
    more = replace(keys, values=values, labels=("Puff", *keys.labels))
    return replace(asset, attributes=tuple(more if each is keys else each for each in asset.attributes))


def as_one_mesh(asset: Asset) -> Asset:
    """The asset without its nodes, so that its surface is written as one mesh."""
    return replace(asset, nodes=())


def write_document(asset: Asset, path: Path) -> tuple[Document, tuple[str, ...]]:
    """The document of a written file, and the notes."""
    notes = write_asset(asset, path.with_name("out.glb"))
    return Document(path.with_name("out.glb")), notes


def with_weights(path: Path, nodes: Sequence[int], interpolation: str = "LINEAR") -> Asset:
    """The asset of a file that animates the weights of nodes, at two times."""
    tree = tree_of(path)
    channels = [{"sampler": at, "target": {"node": node, "path": "weights"}} for at, node in enumerate(nodes)]
    (sampler,) = tree["animations"][0]["samplers"]
    samplers = [{**sampler, "interpolation": interpolation} for _ in nodes]
    return read_with_tables(path, animations=[{"name": "Face", "channels": channels, "samplers": samplers}])


def animated_weights(document: Document, node: int) -> np.ndarray:
    """(keyframes, morph targets) the weights of a node."""
    (animation,) = document.gltf.animations
    (channel,) = [each for each in animation.channels if each.target.node == node]
    mesh = document.gltf.meshes[document.gltf.nodes[node].mesh]
    values = document.array(animation.samplers[channel.sampler].output)
    return values.reshape(-1, len(mesh.primitives[0].targets))


def test_animated_weights_follow_their_morph_targets(path: Path) -> None:
    document, notes = write_document(with_key_first(with_weights(path, [FACE])), path)
    assert notes == ()
    assert document.gltf.meshes[1].extras["targetNames"] == ["Fcl_Blink", "Fcl_A", "Puff"]
    assert document.gltf.meshes[0].extras["targetNames"] == ["Puff"]
    np.testing.assert_allclose(animated_weights(document, FACE), [[0, 0.5, 0], [1, 0.25, 0]])
    document, notes = write_document(as_one_mesh(with_key_first(with_weights(path, [FACE]))), path)
    assert document.gltf.meshes[0].extras["targetNames"] == ["Puff", "Fcl_Blink", "Fcl_A"]
    np.testing.assert_allclose(animated_weights(document, BODY), [[0, 0, 0.5], [0, 1, 0.25]])


def test_animated_weights_of_two_meshes_are_kept_unless_joined(path: Path) -> None:
    tree = tree_of(path)
    tree["nodes"].append({"name": "Mask", "mesh": 1, "skin": 1})
    tree["nodes"][0]["children"].append(len(tree["nodes"]) - 1)
    replace_tree(path, tree)
    asset = with_weights(path, [FACE, len(tree["nodes"]) - 1])
    document, notes = write_document(asset, path)
    assert notes == ()
    for node in (FACE, len(tree["nodes"]) - 1):
        np.testing.assert_allclose(animated_weights(document, node), [[0, 0.5], [1, 0.25]])
    document, notes = write_document(as_one_mesh(asset), path)
    assert "Animated weights of several meshes' morph targets were left out, because they were joined." in notes
    assert document.gltf.animations == []


def with_pointers(path: Path, pointers: Sequence[str]) -> Asset:
    """The asset of a file with a channel for each pointer, with weights of two morph targets or of one."""
    tree = tree_of(path)
    (sampler,) = tree["animations"][0]["samplers"]
    single = {**sampler, "output": sampler["input"]}
    channels = [
        {
            "sampler": int(not pointer.endswith("weights")),
            "target": {"path": "pointer", "extensions": {POINTER: {"pointer": pointer}}},
        }
        for pointer in pointers
    ]
    return read_with_tables(
        path, animations=[{"channels": channels, "samplers": [sampler, single]}], extensionsUsed=[POINTER]
    )


def pointers_of(document: Document) -> list[str]:
    return [
        channel.target.extensions[POINTER]["pointer"]
        for animation in document.gltf.animations
        for channel in animation.channels
    ]


def test_animation_pointers_follow_their_meshes(path: Path) -> None:
    material, place = "/materials/0/pbrMetallicRoughness/metallicFactor", f"/nodes/{HAT}/scale"
    pointers = ["/meshes/1/weights", f"/nodes/{FACE}/weights/1", "/meshes/1/weights/0", material, place]
    asset = with_pointers(path, pointers)
    document, notes = write_document(with_key_first(asset), path)
    assert notes == ()
    assert pointers_of(document) == pointers
    assert POINTER in document.gltf.extensionsUsed
    animation = document.gltf.animations[0]
    weights = document.array(animation.samplers[animation.channels[0].sampler].output).reshape(2, 3)
    np.testing.assert_allclose(weights, [[0, 0.5, 0], [1, 0.25, 0]])
    for channel in animation.channels[1:]:
        np.testing.assert_allclose(document.array(animation.samplers[channel.sampler].output).ravel(), [0, 1])
    document, notes = write_document(as_one_mesh(with_key_first(asset)), path)
    assert pointers_of(document) == [
        "/meshes/0/weights",
        f"/nodes/{BODY}/weights/2",
        "/meshes/0/weights/1",
        *pointers[3:],
    ]
    # Without the morph targets and the materials, only the node is left.
    plain = replace(asset, attributes=(), materials=(Material("Grey"),))
    document, notes = write_document(plain, path)
    assert pointers_of(document) == [place]
    assert notes == ("Animations of materials or morph targets that are gone were left out.",)


@pytest.mark.parametrize(
    "pointer", ["", "/", "/nodes", "/nodes/x/weights", "/nodes/99/weights", "/meshes/-1/weights/0"]
)
def test_dangling_animation_pointers_raise_no_error(path: Path, pointer: str) -> None:
    write_document(with_pointers(path, [pointer]), path)
    write_document(as_one_mesh(read_asset(path)), path)


def test_malformed_animation_pointer_is_refused(path: Path) -> None:
    tree = tree_of(path)
    tree["animations"][0]["channels"][0]["target"] = {"path": "pointer", "extensions": {POINTER: 5}}
    replace_tree(path, tree)
    with pytest.raises(MeshError, match="KHR_animation_pointer is 5, not an object"):
        read_asset(path)


def test_weights_of_a_node_become_those_of_its_mesh(path: Path) -> None:
    tree = tree_of(path)
    tree["nodes"][FACE]["weights"] = [0.5, 0.75]
    document, _ = write_document(with_key_first(read_with_tables(path, nodes=tree["nodes"])), path)
    assert document.gltf.meshes[1].weights == [0.5, 0.75, 0]
    tree["nodes"][BODY]["weights"] = [1]
    document, _ = write_document(as_one_mesh(with_key_first(read_with_tables(path, nodes=tree["nodes"]))), path)
    assert document.gltf.meshes[0].weights == [0, 0.5, 0.75]
    tree["nodes"][FACE]["weights"] = ["much"]
    with pytest.raises(MeshError, match='weights is "much", not a number'):
        read_with_tables(path, nodes=tree["nodes"])


def test_variants_of_each_mesh_are_kept(path: Path) -> None:
    tree, name = tree_of(path), "KHR_materials_variants"
    for number, mesh in enumerate(tree["meshes"]):
        mesh["primitives"][0]["extensions"] = {name: {"mappings": [{"material": number, "variants": [0]}]}}
    asset = read_with_tables(path, meshes=tree["meshes"], extensions={name: {"variants": [{"name": "dark"}]}})
    document, notes = write_document(asset, path)
    assert notes == ()
    found = [mesh.primitives[0].extensions[name]["mappings"][0]["material"] for mesh in document.gltf.meshes]
    assert found == [0, 1, 2]
    notes = write_document(as_one_mesh(asset), path)[1]
    assert any(note.startswith("Some parts with the same material have different material variants") for note in notes)


def test_only_extensions_in_use_are_declared(path: Path) -> None:
    tree = tree_of(path)
    tree["meshes"][2]["extensions"] = {"EXT_of_mesh": {"felt": []}}
    tree["nodes"][2]["extensions"] = {"EXT_of_node": {"node": 1}}
    declared = ["KHR_mesh_quantization", "EXT_of_mesh", "EXT_of_node"]
    asset = read_with_tables(
        path, meshes=tree["meshes"], nodes=tree["nodes"], extensionsUsed=declared, extensionsRequired=declared[:2]
    )
    document, _ = write_document(asset, path)
    assert document.gltf.meshes[2].extensions == {"EXT_of_mesh": {"felt": []}}
    assert document.gltf.nodes[2].extensions == {"EXT_of_node": {"node": 1}}
    assert set(document.gltf.extensionsUsed) >= {"EXT_of_mesh", "EXT_of_node"}
    assert "KHR_mesh_quantization" not in document.gltf.extensionsUsed
    assert document.gltf.extensionsRequired == ["EXT_of_mesh"]
    document, _ = write_document(as_one_mesh(asset), path)
    assert "EXT_of_mesh" not in (*document.gltf.extensionsUsed, *document.gltf.extensionsRequired)


def test_new_surface_uses_the_node_of_the_largest_skinned_mesh(path: Path) -> None:
    document, _ = write_document(as_one_mesh(read_asset(path)), path)
    assert [number for number, node in enumerate(document.gltf.nodes) if node.mesh is not None] == [BODY]
    assert document.gltf.nodes[BODY].skin == 0
    again = read_asset(path.with_name("out.glb")).surface
    np.testing.assert_allclose(
        np.sort(again.vertices, axis=0), np.sort(read_asset(path).surface.vertices, axis=0), atol=1e-6
    )


def test_a_scene_without_joints_keeps_its_nodes(tmp_path: Path) -> None:
    made = gltf.GLTF2(asset=gltf.Asset(version="2.0"), scene=0, scenes=[gltf.Scene(nodes=[0, 2])])
    turn = Rotation.from_euler("xyz", [20, 30, 40], degrees=True).as_quat().tolist()
    made.nodes = [
        gltf.Node(name="A", children=[1], scale=[2, 1, 1], translation=[1, 2, 3], rotation=turn),
        gltf.Node(name="B", mesh=0, rotation=turn),
        gltf.Node(name="C", mesh=1, scale=[1, -1, 1], translation=[9, 0, 0]),
    ]
    buffer, shapes = Buffer(made), [ball(1, seed=seed) for seed in (0, 1)]
    for shape in shapes:
        at = gltf.Attributes(POSITION=buffer.add(shape.vertices.astype("<f4"), bounded=True))
        primitive = gltf.Primitive(attributes=at, indices=buffer.add(shape.triangles.ravel().astype("<u2")))
        made.meshes.append(gltf.Mesh(name="M", primitives=[primitive]))
    buffer.finish()
    path = tmp_path / "scene.glb"
    path.write_bytes(b"".join(made.save_to_bytes()))
    asset = read_asset(path)
    document, notes = write_document(asset, path)
    assert notes == ()
    assert [node.mesh for node in document.gltf.nodes] == [None, 0, 1]
    for mesh, shape in zip(document.gltf.meshes, shapes, strict=True):
        (primitive,) = mesh.primitives
        positions = document.array(primitive.attributes.POSITION)
        assert np.linalg.norm(positions[:, None] - shape.vertices, axis=2).min(axis=1).max() < 1e-5
        corners = positions[document.array(primitive.indices).reshape(-1, 3)]
        assert np.linalg.det(corners).min() > 0  # seen from outside
        assert np.einsum("nx,nx->n", document.array(primitive.attributes.NORMAL), positions).min() > 0
    np.testing.assert_allclose(
        read_asset(path.with_name("out.glb")).surface.vertices, asset.surface.vertices, atol=1e-5
    )
    # Another surface is placed in the frame of the node.
    other = Surface(3 * asset.surface.vertices[:60], asset.surface.triangles[: len(shapes[0].triangles)])
    write_document(replace(asset, surface=other, attributes=(), nodes=()), path)
    np.testing.assert_allclose(read_asset(path.with_name("out.glb")).surface.vertices, other.vertices, atol=1e-4)


def test_unused_skin_is_kept(path: Path) -> None:
    tree = tree_of(path)
    tree["skins"].insert(0, {"name": "Spare", "joints": [3, 4], "inverseBindMatrices": None})
    del tree["skins"][0]["inverseBindMatrices"]
    tree["nodes"][BODY]["skin"], tree["nodes"][FACE]["skin"] = 1, 2
    document, _ = write_document(read_with_tables(path, skins=tree["skins"], nodes=tree["nodes"]), path)
    assert [skin.name for skin in document.gltf.skins] == ["Spare", "Torso", "Skull"]
    assert [document.gltf.nodes[node].skin for node in (BODY, FACE, HAT)] == [1, 2, None]
    assert document.gltf.skins[2].skeleton == document.gltf.skins[2].joints[0]
    assert document.gltf.skins[2].extras == {"of": "Skull"}


def test_vertex_bound_to_a_foreign_joint_adds_it_to_the_skin(path: Path) -> None:
    asset = read_asset(path)
    assert asset.skin is not None
    weights = asset.skin.weights.toarray()
    hips = asset.skin.names.index("J_hips")
    weights[200] = np.eye(len(asset.skin.names))[hips]
    changed_skin = replace(asset.skin, weights=type(asset.skin.weights)(weights))
    document, _ = write_document(replace(asset, skin=changed_skin), path)
    again = read_asset(path.with_name("out.glb"))
    assert len(document.gltf.skins[1].joints) == 3
    assert document.gltf.skins[1].skeleton is None  # the head is not above the hips
    assert again.skin is not None
    at = np.linalg.norm(again.skin.rest - asset.skin.rest[200], axis=1).argmin()
    assert again.skin.weights.toarray()[at].argmax() == again.skin.names.index("J_hips")


def test_animated_weights_of_wrong_length_are_left_out(path: Path) -> None:
    tree = tree_of(path)
    tree["accessors"][tree["animations"][0]["samplers"][0]["output"]]["count"] = 3
    document, notes = write_document(with_key_first(read_with_tables(path, accessors=tree["accessors"])), path)
    assert notes == ("Animations of materials or morph targets that are gone were left out.",)
    assert document.gltf.animations == []
