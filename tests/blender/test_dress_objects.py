# SPDX-License-Identifier: GPL-3.0-or-later
"""Dressing: copies of clothes, hair and props on a target, posed and at rest, before and after binding."""

import bpy
import numpy as np
import pytest
from bent_tube import tube, weights_of
from mathutils import Matrix
from rigged import BONES, OTHER, mesh_object, pose_target, set_pose, source_and_rig, visible_positions
from scenes import activate, add_uv_map, key_shape, link, positions, set_weights, snapshot, snapshot_file

import zoomout_core as zo
from blender_addon import api
from blender_addon.mesh_data import groups_to_keep
from blender_addon.scene.selection import chosen_targets, source_name
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.transfer.dressing import fitted_object

RADIUS_OF_SLEEVE = 1.12


def sleeve(armature):
    """A piece of a wider tube around the source, bound to its rig."""
    surface = tube(around=16, along=31)
    points = surface.vertices * [RADIUS_OF_SLEEVE, RADIUS_OF_SLEEVE, 1]
    middle = np.abs(points[:, 2] - 3) < 1.8
    triangles = surface.triangles[middle[surface.triangles].all(axis=1)]
    kept, number = np.unique(triangles, return_inverse=True)
    obj = mesh_object("Sleeve", zo.Surface(points[kept], number.reshape(-1, 3)))
    for name, column in zip(BONES, weights_of(points[kept]).toarray().T, strict=True):
        set_weights(obj, name, column)
    obj.parent = armature
    obj.modifiers.new("Skeleton", "ARMATURE").object = armature
    bpy.context.view_layer.update()
    return obj


def ring(armature):
    """A prop parented to the upper bone."""
    obj = mesh_object("Ring", tube(around=12, along=7))
    width = np.ptp(positions(obj.data), axis=0).max()
    obj.data.transform(Matrix.Translation((1.6, 0, 5)) @ Matrix.Diagonal((0.5 / width,) * 3 + (1,)))
    obj.parent, obj.parent_type, obj.parent_bone = armature, "BONE", "Upper"
    bpy.context.view_layer.update()
    obj.matrix_parent_inverse = obj.matrix_world.inverted()
    bpy.context.view_layer.update()
    return obj


def side(points, body):
    """(n,) signed distances of points from an evaluated body, negative inside."""
    body.data.calc_loop_triangles()
    triangles = np.array([list(triangle.vertices) for triangle in body.data.loop_triangles])
    vertices = visible_positions(body).astype(float)
    triangle, weights = closest_points(np.asarray(points, float), vertices, triangles)
    corners = vertices[triangles[triangle]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    off = points - np.einsum("nc,ncx->nx", weights, corners)
    return np.linalg.norm(off, axis=1) * np.sign(np.einsum("nx,nx->n", off, normals))


@pytest.fixture
def source():
    return source_and_rig()


@pytest.mark.slow
def test_unbound_target_is_dressed_in_its_pose(source):
    body, armature = source
    cloth = sleeve(armature)
    before, apart = snapshot(cloth), np.median(side(visible_positions(cloth), body))
    target, _ = pose_target(body, armature)
    report = api.dress(bpy.context, body, target, [cloth])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    assert snapshot(cloth) == before
    assert copy.users_collection[0].name == "Target Dress"
    assert copy.parent == target
    assert not copy.modifiers
    off = side(visible_positions(copy), target)
    assert off.min() > 0
    assert abs(np.median(off) - apart) < 0.3 * apart
    assert {group.name for group in copy.vertex_groups} == set(BONES)
    assert "is not bound to the armature of 'Source'" in report["notes"][0]
    place = visible_positions(copy)
    target.location.x += 3
    bpy.context.view_layer.update()
    np.testing.assert_allclose(visible_positions(copy) - place, np.broadcast_to([3, 0, 0], place.shape), atol=1e-5)


@pytest.mark.slow
def test_stretched_copies_are_named(source, monkeypatch):
    body, armature = source
    target, _ = pose_target(body, armature)
    cloth = sleeve(armature)
    assert not any("stretched" in note for note in api.dress(bpy.context, body, target, [cloth])["notes"])
    monkeypatch.setattr(fitted_object, "STRETCHED", 1.0)
    monkeypatch.setattr(fitted_object, "MIN_LENGTH", 0.0)
    report = api.dress(bpy.context, body, target, [cloth])
    assert any("vertices of 'Sleeve' stretch far more than the body" in note for note in report["notes"])


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("dressed_first", [True, False])
def test_the_rig_poses_the_target_and_its_clothes_alike(source, dressed_first):
    body, armature = source
    cloth, prop = sleeve(armature), ring(armature)
    target, _ = pose_target(body, armature)
    if dressed_first:
        report = api.dress(bpy.context, body, target, [cloth, prop])
        api.bind_to_rig(bpy.context, body, target)
    else:
        api.bind_to_rig(bpy.context, body, target)
        set_pose(armature, OTHER)  # which does not matter
        report = api.dress(bpy.context, body, target, [cloth, prop])
    copy, hung = (bpy.data.objects[report["objects"][name]] for name in ("Sleeve", "Ring"))
    assert copy.parent == armature
    assert [modifier.object for modifier in copy.modifiers] == [armature]
    assert (hung.parent, hung.parent_type, hung.parent_bone) == (armature, "BONE", "Upper")
    for pose in ({}, OTHER):
        set_pose(armature, pose)
        off = side(visible_positions(copy), target)
        assert (off < 0).mean() < 0.02
        truth = np.linalg.norm(visible_positions(copy) - visible_positions(cloth), axis=1)
        assert np.median(truth) < 0.12
        assert np.linalg.norm((visible_positions(hung) - visible_positions(prop)).mean(axis=0)) < 0.15


def test_dressing_copies_shape_keys_and_replaces_earlier_copies(source):
    body, armature = source
    target, _ = pose_target(body, armature, {})
    cloth = mesh_object("Cloth", tube(around=16, along=31))
    cloth.data.transform(Matrix.Diagonal((RADIUS_OF_SLEEVE, RADIUS_OF_SLEEVE, 1, 1)))
    cloth.shape_key_add(name="Basis")
    wide = cloth.shape_key_add(name="Wide")
    wide.data.foreach_set("co", (1.3 * positions(cloth.data) * [1, 1, 1 / 1.3]).astype(np.float32).ravel())
    bpy.context.view_layer.update()
    first = api.dress(bpy.context, body, target, [cloth])
    again = api.dress(bpy.context, body, target, [cloth], api.Dressing(gap=0.3))
    assert first["objects"] == again["objects"]
    (copy,) = bpy.data.collections["Target Dress"].objects
    base, moved = (key_shape(copy.data, name) for name in ("Basis", "Wide"))
    width = np.linalg.norm(key_shape(cloth.data, "Wide") - key_shape(cloth.data, "Basis"), axis=1)
    np.testing.assert_allclose(np.linalg.norm(moved - base, axis=1), width, rtol=0.25, atol=0.02)
    assert side(visible_positions(copy), target).min() > 0.25


def test_hair_is_attached_to_the_target(source):
    body, armature = source
    target, _ = pose_target(body, armature, {})
    add_uv_map(target.data, "UVMap")
    places = visible_positions(body)[::40].astype(float)
    hair = bpy.data.hair_curves.new("Hair")
    hair.add_curves([3] * len(places))
    outwards = places * [1, 1, 0]
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    strands = np.stack([places + 0.1 * i * outwards for i in range(3)], axis=1).reshape(-1, 3)
    hair.position_data.foreach_set("vector", strands.astype(np.float32).ravel())
    hair.surface = body
    obj = link("Hair", hair)
    bpy.context.view_layer.update()
    report = api.dress(bpy.context, body, target, [obj])
    copy = bpy.data.objects[report["objects"]["Hair"]]
    assert copy.data.surface == target
    assert hair.surface == body
    assert copy.data.surface_uv_map == "UVMap"
    uv = np.array([each.vector[:] for each in copy.data.attributes["surface_uv_coordinate"].data])
    points = np.array([point.position[:] for point in copy.data.points]) @ np.array(copy.matrix_world)[:3, :3].T
    roots = points[::3] + np.array(copy.matrix_world.translation)
    assert np.abs(side(roots, target)).max() < 0.02
    np.testing.assert_allclose(uv, roots[:, :2] / 4 + 0.5, atol=0.02)  # as `add_uv_map` lays it out


def test_objects_named_like_hair_hang_as_a_whole(source):
    body, armature = source
    cloth = sleeve(armature)
    cloth.name = "LongHair"
    target, _ = pose_target(body, armature)
    found = []
    for manner in ("automatic", "hair", "soft"):
        report = api.dress(bpy.context, body, target, [cloth], api.Dressing(manner=manner))
        found.append(visible_positions(bpy.data.objects[report["objects"]["LongHair"]]))
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
    assert np.abs(found[0] - found[2]).max() > 0.01


def test_undressable_objects_are_reported(source):
    body, armature = source
    target, _ = pose_target(body, armature, {})
    empty = link("Empty", None)
    with pytest.raises(zo.MeshError, match="'Empty' is neither a mesh nor hair curves"):
        api.dress(bpy.context, body, target, [empty])
    with pytest.raises(zo.MeshError, match="There is nothing to dress 'Target' with"):
        api.dress(bpy.context, body, target, [body, target])
    assert "Target Dress" not in bpy.data.collections
    report = api.dress(bpy.context, body, target, [empty, sleeve(armature)])
    assert list(report["objects"]) == ["Sleeve"]
    assert list(report["left_out"]) == ["Empty"]


def test_kept_vertex_group_stays_rigid(source):
    body, armature = source
    cloth = sleeve(armature)
    rest = visible_positions(cloth).astype(float)
    place = rest[np.argmax(rest[:, 0])]
    mask = np.linalg.norm(rest - place, axis=1) < 0.8
    set_weights(cloth, "Buckle", mask)
    target, _ = pose_target(body, armature)
    activate(target, cloth)
    bpy.context.scene.zoomout.source = body
    bent = []
    for group in ("", "Buckle"):
        assert bpy.ops.zoomout.dress(dress_keep=group) == {"FINISHED"}
        (copy,) = bpy.data.collections["Target Dress"].objects
        moved = visible_positions(copy)[mask].astype(float)
        bent.append(np.linalg.norm(procrustes(rest[mask], moved)(rest[mask]) - moved, axis=1).max())
    assert bent[0] > 0.05
    assert bent[1] < 1e-4
    # The copy still keeps it when it is taken to the rest pose.
    api.bind_to_rig(bpy.context, body, target)
    moved = np.array([vertex.co[:] for vertex in copy.data.vertices])[mask]
    assert np.linalg.norm(procrustes(rest[mask], moved)(rest[mask]) - moved, axis=1).max() < 1e-4
    assert groups_to_keep([copy, target]) == ["Buckle"]
    report = api.dress(bpy.context, body, target, [cloth], api.Dressing(keep="Plate"))
    assert any(note.startswith("None of the objects has a vertex group 'Plate'") for note in report["notes"])


def test_dressing_is_one_undo_step(source):
    body, armature = source
    cloth = sleeve(armature)
    target, _ = pose_target(body, armature, {})
    activate(target, cloth)
    bpy.context.scene.zoomout.source = body
    before = snapshot_file()
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.zoomout.dress("EXEC_DEFAULT", True) == {"FINISHED"}
    bpy.ops.ed.undo()
    assert snapshot_file() == before
    assert {obj.name for obj in bpy.context.selected_objects} == {"Target", "Sleeve"}


def test_operator_dresses_with_selection_or_collection(source):
    body, armature = source
    cloth = sleeve(armature)
    target, _ = pose_target(body, armature, {})
    activate(target, cloth, body)
    assert bpy.ops.zoomout.dress() == {"FINISHED"}
    assert [obj["zoomout_dressed"] for obj in bpy.data.collections["Target Dress"].objects] == ["Sleeve"]
    # The copies are selected, but are neither targets nor the source, and dressing again replaces them.
    (copy,) = bpy.data.collections["Target Dress"].objects
    assert set(bpy.context.selected_objects) == {target, copy}
    assert chosen_targets(bpy.context, body) == [target]
    assert source_name(bpy.context, target) == body.name
    assert bpy.ops.zoomout.dress() == {"FINISHED"}
    assert [obj["zoomout_dressed"] for obj in bpy.data.collections["Target Dress"].objects] == ["Sleeve"]
    clothes = bpy.data.collections.new("Clothes")
    bpy.context.scene.collection.children.link(clothes)
    clothes.objects.link(cloth)
    activate(target)
    with pytest.raises(RuntimeError, match="There is nothing to dress 'Target' with"):
        bpy.ops.zoomout.dress()
    bpy.context.scene.zoomout.dress_collection = clothes
    assert bpy.ops.zoomout.dress(dress_gap=0.2) == {"FINISHED"}
    (copy,) = bpy.data.collections["Target Dress"].objects
    assert side(visible_positions(copy), target).min() > 0.15
