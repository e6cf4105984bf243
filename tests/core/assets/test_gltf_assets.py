# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF files are read with all their data, and a round trip keeps it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from creatures import creature
from scipy.sparse import csr_array
from skinned_tubes import LENGTH, PNG, RINGS, SIDES, tube, weights_of, write_tube

from zoomout_core.assets.asset import NORMALS, SHAPE_KEYS, Asset, Material, material_numbers
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.formats.gltf_document import Document
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.messages import is_warning
from zoomout_core.transfer.attribute import Attribute, Domain, Kind


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "tube.glb"


def test_vertices_split_at_uv_seams_are_merged(path: Path) -> None:
    write_tube(path)
    asset = read_asset(path)
    positions, uv, triangles = tube()
    assert len(asset.surface.vertices) == RINGS * SIDES < len(positions)
    np.testing.assert_allclose(
        asset.surface.vertices[asset.surface.corner_vertex], positions[triangles.ravel()], atol=1e-6
    )
    found = asset.find("uv 0")
    assert found is not None
    np.testing.assert_allclose(found.values, uv[triangles.ravel()] * [1, -1] + [0, 1], atol=1e-6)
    assert asset.materials == (Material("Cloth 0", (0.5, 0.25, 0, 1), PNG),)


@pytest.mark.parametrize("armature_scale", [1.0, 0.01])
def test_skin_is_read_at_rest_from_any_pose_and_frame(path: Path, armature_scale: float) -> None:
    write_tube(path, armature_scale, bend=0.9)
    asset = read_asset(path)
    skin, positions = asset.skin, tube()[0]
    assert skin is not None
    assert skin.names == ("Lower", "Upper")
    assert skin.parents.tolist() == [-1, 0]
    np.testing.assert_allclose(skin.weights.toarray(), weights_of(skin.rest[:, 1] * armature_scale), atol=1e-6)
    at_rest = skin.rest * armature_scale
    assert np.linalg.norm(at_rest[:, None] - positions, axis=2).min(axis=1).max() < 1e-5
    # The end of the tube rotates about the joint by 0.9 radians; the part below stays.
    end, fixed = at_rest[:, 1] > 0.99 * LENGTH, at_rest[:, 1] < 0.29 * LENGTH
    turn = np.array([[np.cos(0.9), -np.sin(0.9), 0], [np.sin(0.9), np.cos(0.9), 0], [0, 0, 1]])
    joint = np.array([0, LENGTH / 2, 0])
    np.testing.assert_allclose(asset.surface.vertices[end], (at_rest[end] - joint) @ turn.T + joint, atol=1e-5)
    np.testing.assert_allclose(asset.surface.vertices[fixed], at_rest[fixed], atol=1e-5)
    keys = asset.find(SHAPE_KEYS)
    assert keys is not None
    assert keys.labels == ("Lean",)
    np.testing.assert_allclose(keys.values[fixed, 0, 0], at_rest[fixed, 1] / LENGTH, atol=1e-5)
    np.testing.assert_allclose(keys.values[end, 0], np.tile(turn @ [1, 0, 0], (end.sum(), 1)), atol=1e-5)


def test_vertices_without_weights_follow_their_first_joint(path: Path) -> None:
    write_tube(path, bend=0.9)
    whole = read_asset(path)
    write_tube(path, bend=0.9, bare=True)
    bare = read_asset(path)
    np.testing.assert_array_equal(bare.surface.vertices, whole.surface.vertices)
    assert whole.skin is not None
    assert bare.skin is not None
    np.testing.assert_array_equal(bare.skin.weights.toarray(), whole.skin.weights.toarray())
    assert whole.notes == ()
    (note,) = bare.notes
    assert is_warning(note)
    assert note.startswith(f"{SIDES} vertices in tube.glb have no skin weights")


def as_corners(asset: Asset) -> np.ndarray:
    """(c, ...) positions, texture coordinates, weights and rest positions of the corners, sorted by value."""
    uv = asset.find("uv 0")
    assert uv is not None
    assert asset.skin is not None
    vertex = asset.surface.corner_vertex
    rows = np.hstack(
        [asset.surface.vertices[vertex], uv.values, asset.skin.weights.toarray()[vertex], asset.skin.rest[vertex]]
    )
    return rows[np.lexsort(np.round(rows, 4).T)]


def write_normals(asset: Asset) -> Asset:
    """The asset with its smooth normals as a corner attribute."""
    smooth = vertex_normals(asset.surface.vertices, asset.surface.triangles)[asset.surface.corner_vertex]
    return replace(asset, attributes=(*asset.attributes, Attribute(NORMALS, Domain.CORNER, Kind.NORMAL, smooth)))


def vectors_at_corners(asset: Asset, name: str) -> np.ndarray:
    """(c, 3) values of a normal or offset attribute at the corners, sorted by position."""
    attribute, surface = asset.find(name), asset.surface
    assert attribute is not None
    values = attribute.values if attribute.domain is Domain.CORNER else attribute.values[surface.corner_vertex, 0]
    return np.asarray(values[np.lexsort(np.round(surface.vertices[surface.corner_vertex], 4).T)])


@pytest.mark.parametrize("ending", [".glb", ".gltf"])
def test_gltf_round_trip_keeps_all_data(path: Path, ending: str) -> None:
    write_tube(path, 0.1, bend=0.4, parts=3)
    asset = write_normals(read_asset(path))
    there = path.with_name(f"again{ending}")
    assert write_asset(asset, there) == ()
    again = read_asset(there)
    np.testing.assert_allclose(as_corners(again), as_corners(asset), atol=1e-4)
    for name in (NORMALS, SHAPE_KEYS):
        assert np.abs(vectors_at_corners(again, name) - vectors_at_corners(asset, name)).max() < 1e-3
    assert again.materials == asset.materials
    before, after = asset.skin, again.skin
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(after.inverse_bind, before.inverse_bind)
    assert after.names == before.names
    # The rotation channel keeps its joint; the weights channel targets the node of the new mesh.
    old, new = Document(path), Document(there)
    (animation,) = new.gltf.animations
    assert [channel.target.path for channel in animation.channels] == ["rotation", "weights"]
    assert animation.channels[0].target.node == 2
    assert new.gltf.nodes[animation.channels[1].target.node].mesh == 0
    for number, sampler in enumerate(animation.samplers):
        was = old.gltf.animations[0].samplers[number]
        np.testing.assert_array_equal(new.array(sampler.output), old.array(was.output))
    assert new.gltf.meshes[0].extras == {"targetNames": ["Lean"]}
    # The old mesh is gone.
    assert sum(node.mesh is not None for node in new.gltf.nodes) == 1


def test_many_layers_keep_their_numbers(path: Path) -> None:
    surface = creature(60).surface
    layers = [
        Attribute(f"uv {number}", Domain.CORNER, Kind.UV, np.full((len(surface.corner_vertex), 2), number))
        for number in range(12)
    ]
    write_asset(Asset(surface, tuple(layers)), path)
    found = [each for each in read_asset(path).attributes if each.kind is Kind.UV]
    assert [each.name for each in found] == [each.name for each in layers]
    assert [np.unique(each.values).tolist() for each in found] == [[number] for number in range(12)]


def test_written_weights_sum_to_one_and_unused_joints_are_zero(path: Path) -> None:
    write_tube(path)
    asset = read_asset(path)
    assert asset.skin is not None
    uneven = csr_array(np.maximum(asset.skin.weights.toarray() * 0.7, 1e-60))  # zero as single floats
    write_asset(replace(asset, skin=replace(asset.skin, weights=uneven)), path)
    document = Document(path)
    attributes = document.gltf.meshes[0].primitives[0].attributes
    weights, joints = document.array(attributes.WEIGHTS_0), document.array(attributes.JOINTS_0)
    assert weights.dtype == np.float32
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=2e-7)
    assert (np.diff(weights, axis=1) <= 0).all()
    assert (joints[weights == 0] == 0).all()


def test_a_mesh_without_a_document_is_written_with_its_materials(tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    surface = Surface(vertices, [[0, 1, 2], [0, 2, 3]])
    color = Attribute(
        "color 0", Domain.POINT, Kind.COLOR, np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float)
    )
    materials = Material("A", (1, 0, 0, 1)), Material("B", image=PNG)
    asset = Asset(surface, (color, material_numbers(np.array([1, 0]))), materials)
    write_asset(asset, tmp_path / "new.glb")
    again = read_asset(tmp_path / "new.glb")
    assert again.materials == materials
    numbers, colors = again.find("materials"), again.find("color 0")
    assert numbers is not None
    assert colors is not None
    assert sorted(numbers.values.tolist()) == [0, 1]
    at_corner = again.surface.vertices[again.surface.corner_vertex]
    expected = color.values[np.argmin(np.linalg.norm(at_corner[:, None] - vertices, axis=2), axis=1)]
    np.testing.assert_allclose(colors.values[:, :3], expected, atol=1e-6)
    assert again.find(NORMALS) is not None


def edit_json(path: Path, change: object) -> None:
    """Change the JSON of a GLB file."""
    content = path.read_bytes()
    size = int.from_bytes(content[12:16], "little")
    text = json.dumps(change(json.loads(content[20 : 20 + size]))).encode()  # type: ignore[operator]
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    head = content[:8] + (20 + len(text) + len(rest)).to_bytes(4, "little") + len(text).to_bytes(4, "little") + b"JSON"
    path.write_bytes(head + text + rest)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda made: made | {"meshes": [{"primitives": []}]}, "contains no triangles"),
        (
            lambda made: made | {"bufferViews": [view | {"byteLength": 8} for view in made["bufferViews"]]},
            "than its view",
        ),
        (lambda made: made | {"accessors": []}, "could not be read"),
    ],
)
def test_unusable_files_are_refused(path: Path, change: object, sentence: str) -> None:
    write_tube(path)
    edit_json(path, change)
    with pytest.raises(MeshError, match=sentence):
        read_asset(path)


def test_truncated_file_is_refused(path: Path) -> None:
    write_tube(path)
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(MeshError, match=r"could not be read .* check that the file is complete"):
        read_asset(path)


def test_mesh_parented_to_a_joint_moves_with_it(path: Path) -> None:
    write_tube(path, bend=0.9)

    def hang(made: dict) -> dict:
        """Give the upper joint a second node with the same mesh, without a skin."""
        made["nodes"].append({"name": "Hat", "mesh": 0, "translation": [0, 3, 0]})
        made["nodes"][2]["children"] = [len(made["nodes"]) - 1]
        return made

    edit_json(path, hang)
    asset = read_asset(path)
    assert asset.skin is not None
    count = len(asset.surface.vertices) // 2
    upper = [asset.skin.weights.toarray()[part, 1].min() for part in (slice(0, count), slice(count, None))]
    assert sorted(np.round(upper, 6)) == [0, 1]
    hat = slice(0, count) if upper[0] == 1 else slice(count, None)
    matrix = asset.skin.transforms[1]
    moved = asset.skin.rest[hat] @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(moved, asset.surface.vertices[hat], atol=1e-5)


def test_a_mirrored_node_keeps_the_outer_side_of_its_faces(path: Path) -> None:
    write_tube(path)

    def mirror(made: dict) -> dict:
        made["nodes"][3] = {"name": "Tube", "mesh": 0, "scale": [-1, 1, 1]}
        return made

    before = read_asset(path)
    edit_json(path, mirror)
    after = read_asset(path)
    volume = [
        np.linalg.det(each.surface.vertices[each.surface.triangles] - [0, LENGTH / 2, 0]).sum()
        for each in (before, after)
    ]
    assert volume[0] == pytest.approx(volume[1])
    uv, again = before.find("uv 0"), after.find("uv 0")
    assert uv is not None
    assert again is not None
    np.testing.assert_allclose(again.values.reshape(-1, 3, 2)[:, [0, 2, 1]], uv.values.reshape(-1, 3, 2))


def test_strips_and_fans_are_triangulated(path: Path) -> None:
    write_tube(path)
    whole = read_asset(path).surface
    for mode, expected in ((5, 3 * 2), (6, 3 * 2)):

        def as_mode(made: dict, mode: int = mode) -> dict:
            primitive = made["meshes"][0]["primitives"][0]
            primitive["mode"] = mode
            made["accessors"][primitive["indices"]]["count"] = 4
            return made

        write_tube(path)
        edit_json(path, as_mode)
        assert len(read_asset(path).surface.corner_vertex) == expected
    assert len(whole.corner_vertex) > expected


@pytest.mark.parametrize("kind", ["tube", "creature"])
def test_a_shape_has_the_vertices_of_its_asset(path: Path, kind: str) -> None:
    """Otherwise a map between shapes could not be used for a transfer between the same files."""
    if kind == "tube":
        write_tube(path)
    else:
        surface = creature(300).surface
        uv = np.random.default_rng(0).random((len(surface.corner_vertex), 2))
        write_asset(Asset(surface, (Attribute("uv 0", Domain.CORNER, Kind.UV, uv),)), path)
    asset, shape = read_asset(path), read_surface(path)
    np.testing.assert_array_equal(shape.vertices, asset.surface.vertices)
    np.testing.assert_array_equal(shape.corner_vertex, asset.surface.corner_vertex)
