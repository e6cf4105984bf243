# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail are objects with all data of the mesh, grouped and named as engines expect."""

import bpy
import numpy as np
import pytest
from bent_tube import tube
from mathutils import Matrix
from rigged import BONES, POSE, mesh_object, set_pose, source_and_rig, visible_positions
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    key_shape,
    new_material,
    positions,
    set_weights,
    snapshot_file,
    values,
    weight_array,
)

import zoomout_core as zo
from blender_addon import api, mesh_data
from zoomout_core.assets.lods import make_lods
from zoomout_core.geometry.closest_points import closest_points

CHOICE = api.LevelChoice(ratios=(0.5, 0.25), max_weights=2)


@pytest.fixture
def source():
    """A bound tube with a UV map, a colour, two materials, a key with a driver, and custom normals."""
    obj, _ = source_and_rig()
    mesh, points = obj.data, positions(obj.data)
    add_uv_map(mesh, "UVMap")
    add_attribute(mesh, "heat", "FLOAT", "POINT", points[:, 2])
    for name in ("Lower half", "Upper half"):
        mesh.materials.append(new_material(name))
    middle = np.array([face.center.z for face in mesh.polygons])
    mesh.polygons.foreach_set("material_index", (middle > 3).astype(np.int32))
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="Wide")
    key.data.foreach_set("co", (points * [1.5, 1.5, 1]).astype(np.float32).ravel())
    curve = mesh.shape_keys.driver_add('key_blocks["Wide"].value')
    curve.driver.expression = "0"
    mesh.shade_smooth()
    mesh.normals_split_custom_set(np.tile([0.0, 0.0, 1.0], (len(mesh.loops), 1)))
    obj.lock_location[0] = True
    return obj


def test_the_stored_match_is_not_reported_missing(source):
    for name in ("zoomout_triangle", "zoomout_has_partner"):
        add_attribute(source.data, name, "INT", "POINT", np.zeros(len(source.data.vertices), dtype=np.int32))
    add_attribute(source.data, "crease", "FLOAT", "EDGE", np.ones(len(source.data.edges)))
    assert mesh_data.read_detailed_mesh(source).left_out == ("crease",)


def test_levels_have_all_data_and_expected_names(source):
    report = api.make_levels(bpy.context, source, CHOICE)
    collection = bpy.data.collections[report["collection"]]
    assert sorted(obj.name for obj in collection.objects) == ["Source_LOD0", "Source_LOD1", "Source_LOD2"]
    assert bpy.data.objects["Source_LOD0"].data == source.data
    for number, (share, told) in enumerate(zip(CHOICE.ratios, report["levels"], strict=True), 1):
        level = bpy.data.objects[f"Source_LOD{number}"]
        mesh, count = level.data, len(level.data.vertices)
        assert abs(count / len(source.data.vertices) - share) < 0.05
        assert told["vertices"] == count
        assert 0 < told["posed_error"] < 0.01
        assert level.parent == source.parent
        assert level.lock_location[0]
        assert [group.name for group in level.vertex_groups] == list(BONES)
        assert [slot.material for slot in level.material_slots] == [slot.material for slot in source.material_slots]
        assert len(set(values_of(mesh.polygons, "material_index", np.int32))) == 2
        assert mesh.uv_layers.active.name == "UVMap"
        np.testing.assert_allclose(values(mesh, "heat").ravel(), positions(mesh)[:, 2], atol=0.15)
        wide = key_shape(mesh, "Wide") - positions(mesh)
        np.testing.assert_allclose(wide[:, :2], positions(mesh)[:, :2] / 2, atol=0.1)
        assert mesh.shape_keys.animation_data.drivers[0].driver.expression == "0"
        assert mesh.has_custom_normals
        normals = np.array([each.vector for each in mesh.corner_normals])
        np.testing.assert_allclose(normals, np.tile([0, 0, 1], (len(normals), 1)), atol=1e-3)
        each = np.column_stack([weight_array(level, name) for name in BONES])
        assert (each > 0).sum(axis=1).max() <= 2
        np.testing.assert_allclose(each.sum(axis=1), 1, atol=1e-5)


def values_of(items, name, kind):
    found = np.empty(len(items), kind)
    items.foreach_get(name, found)
    return found.tolist()


def test_levels_follow_the_rig_like_the_mesh(source):
    api.make_levels(bpy.context, source, CHOICE)
    level = bpy.data.objects["Source_LOD1"]
    level.hide_set(False)
    set_pose(source.parent, POSE)
    points = visible_positions(source)
    triangles = np.array([triangle.vertices[:] for triangle in level.data.loop_triangles])
    found = visible_positions(level)
    triangle, barycentric = closest_points(points, found, triangles)
    nearest = np.einsum("nk,nkx->nx", barycentric, found[triangles[triangle]])
    assert np.linalg.norm(points - nearest, axis=1).mean() < 0.01


def test_groups_of_bones_have_the_fitted_weights_and_others_those_of_the_mesh(source):
    set_weights(source, "Pinned", np.linspace(0, 1, len(source.data.vertices)))
    detailed = mesh_data.read_detailed_mesh(source)
    (level,) = make_lods(detailed.asset, [0.25], 2)
    made = mesh_data.add_level(source, "Level", detailed, level)
    skin = level.asset.skin
    expected = np.column_stack([skin.weights.toarray()[:, skin.names.index(name)] for name in BONES])
    found, before = (np.column_stack([weight_array(obj, name) for name in BONES]) for obj in (made, source))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.abs(found - before[vertices_of(level)]).max() > 0.01
    pinned = [weight_array(obj, "Pinned") for obj in (made, source)]
    np.testing.assert_allclose(pinned[0], pinned[1][vertices_of(level)], atol=1e-6)


def vertices_of(level):
    """(n,) the vertex of the mesh that each vertex of a simplified level is."""
    found = level.match.surface_map
    return found.source_triangles[found.triangle, found.barycentric.argmax(axis=1)]


def test_levels_replace_earlier_ones_in_the_same_collection(source):
    api.make_levels(bpy.context, source, CHOICE)
    bpy.data.objects["Source_LOD1"].data["mark"] = 1
    meshes = len(bpy.data.meshes)
    report = api.make_levels(bpy.context, source, api.LevelChoice(ratios=(0.4,)))
    assert [obj.name for obj in bpy.data.collections[report["collection"]].objects] == ["Source_LOD0", "Source_LOD1"]
    assert "mark" not in bpy.data.objects["Source_LOD1"].data
    assert len(bpy.data.meshes) == meshes - 1


def test_operator_makes_one_level_per_halving(source):
    source.name = "Hero_LOD0"  # it is level 0 itself
    activate(source)
    assert bpy.ops.zoomout.make_lods(lod_count=2, lod_ratio=0.6) == {"FINISHED"}
    (collection,) = bpy.context.scene.collection.children
    assert collection.name == "Hero LODs"
    assert sorted(obj.name for obj in collection.objects) == ["Hero_LOD1", "Hero_LOD2"]
    counts = [len(bpy.data.objects[f"Hero_LOD{number}"].data.vertices) for number in range(3)]
    np.testing.assert_allclose(np.divide(counts[1:], counts[:-1]), 0.6, atol=0.05)


def test_levels_are_one_undo_step(source):
    activate(source)
    bpy.ops.ed.undo_push(message="Before")
    before = snapshot_file()
    assert bpy.ops.zoomout.make_lods("EXEC_DEFAULT", True) == {"FINISHED"}
    assert snapshot_file() != before
    bpy.ops.ed.undo()
    assert snapshot_file() == before


def test_too_small_level_writes_nothing(source):
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="A level cannot have"):
        api.make_levels(bpy.context, source, api.LevelChoice(ratios=(0.5, 0.0001)))
    assert snapshot_file() == before


@pytest.fixture
def given(source):
    """Two tubes of quads in the place of the source, one moved and rotated as an object, the coarser one first.

    The coarser one has the name of the first level, and both have UV maps whose coordinates are (2, 3).
    """
    made = [mesh_object(name, tube(around, along)) for name, around, along in (("Source_LOD1", 8, 12), ("Low", 12, 25))]
    for obj in made:
        add_uv_map(obj.data, "Own")
        obj.data.uv_layers["Own"].data.foreach_set("uv", np.tile([2.0, 3.0], len(obj.data.loops)))
    turned = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.5, 4, "X")
    made[1].data.transform(turned.inverted())
    made[1].matrix_world = turned
    bpy.context.view_layer.update()
    return made


def test_given_meshes_become_levels_with_the_data_of_the_mesh(source, given):
    coarse, fine = given
    faces = [len(obj.data.polygons) for obj in given]
    activate(source, *given)
    assert bpy.ops.zoomout.make_lods(lod_source="SELECTED", lod_max_weights=2) == {"FINISHED"}
    (collection,) = bpy.context.scene.collection.children
    assert sorted(obj.name for obj in collection.objects) == ["Source_LOD0", "Source_LOD1", "Source_LOD2"]
    assert [obj.name for obj in given] == ["Source_LOD1 given", "Low"]
    assert "UVMap" not in fine.data.uv_layers
    for number, (own, count) in enumerate(((fine, faces[1]), (coarse, faces[0])), start=1):
        level = bpy.data.objects[f"Source_LOD{number}"]
        mesh, points = level.data, positions(level.data)
        assert len(mesh.polygons) == count
        assert {len(face.vertices) for face in mesh.polygons} >= {4}
        expected = [tuple(own.matrix_world @ vertex.co) for vertex in own.data.vertices]
        np.testing.assert_allclose(points, expected, atol=1e-4)
        assert level.parent == source.parent
        assert [slot.material for slot in level.material_slots] == [slot.material for slot in source.material_slots]
        assert len(set(values_of(mesh.polygons, "material_index", np.int32))) == 2
        assert [layer.name for layer in mesh.uv_layers] == ["UVMap"]
        assert np.max(values(mesh, "UVMap")) < 2
        np.testing.assert_allclose(values(mesh, "heat").ravel(), points[:, 2], atol=0.05)
        wide = key_shape(mesh, "Wide") - points
        np.testing.assert_allclose(wide[:, :2], points[:, :2] / 2, atol=0.05)
        assert mesh.shape_keys.animation_data.drivers[0].driver.expression == "0"
        assert mesh.has_custom_normals
        each = np.column_stack([weight_array(level, name) for name in BONES])
        assert (each > 0).sum(axis=1).max() <= 2
        np.testing.assert_allclose(each.sum(axis=1), 1, atol=1e-5)


def test_given_levels_follow_the_rig_like_the_mesh(source, given):
    choice = api.LevelChoice(meshes=tuple(obj.name for obj in given))
    levels = api.make_levels(bpy.context, source, choice)["levels"]
    assert all(each["rest_error"] < 0.02 for each in levels)
    assert all(each["posed_error"] < 1.2 * each["rest_error"] for each in levels)


def test_given_meshes_may_keep_their_uv_maps(source, given):
    choice = api.LevelChoice(meshes=("Low",), keep_uv=True)
    api.make_levels(bpy.context, source, choice)
    (level,) = [obj for obj in bpy.data.objects if obj.name.startswith("Source_LOD1") and obj != given[0]]
    np.testing.assert_allclose(values(level.data, "UVMap"), np.tile([2, 3], (len(level.data.loops), 1)))


def test_edited_level_can_be_given_again(source):
    api.make_levels(bpy.context, source, api.LevelChoice(ratios=(0.5,)))
    edited = positions(bpy.data.objects["Source_LOD1"].data) * [1.01, 1, 1]
    level = bpy.data.objects["Source_LOD1"].data
    level.shape_keys.reference_key.points.foreach_set("co", edited.astype(np.float32).ravel())
    api.make_levels(bpy.context, source, api.LevelChoice(meshes=("Source_LOD1",)))
    assert sorted(obj.name for obj in bpy.data.collections["Source LODs"].objects) == ["Source_LOD0", "Source_LOD1"]
    np.testing.assert_allclose(positions(bpy.data.objects["Source_LOD1"].data), edited, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (Matrix.Translation((2, 0, 0)), "'Low' is not in the place and rest pose of the mesh"),
        (Matrix.Scale(-1, 4, (1, 0, 0)), "'Low' is mirrored by a negative scale"),
    ],
)
def test_unfit_given_meshes_write_nothing(source, given, change, sentence):
    given[1].matrix_world = change @ given[1].matrix_world
    bpy.context.view_layer.update()
    before = snapshot_file()
    activate(source, *given)
    with pytest.raises(RuntimeError, match=sentence):
        bpy.ops.zoomout.make_lods(lod_source="SELECTED")
    assert snapshot_file() == before


def test_selected_meshes_need_a_selection(source):
    activate(source)
    with pytest.raises(RuntimeError, match="No meshes of levels are selected"):
        bpy.ops.zoomout.make_lods(lod_source="SELECTED")
