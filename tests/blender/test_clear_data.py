# SPDX-License-Identifier: GPL-3.0-or-later
"""Clearing removes the add-on's stored data from meshes and scenes, and nothing else."""

import bpy
import pytest
from scenes import activate, add_uv_map, ellipsoid, snapshot_file
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import api
from blender_addon.scene.landmarks import surface_points_on
from blender_addon.services.clear_data import clear_match_data
from blender_addon.services.matching.match import match_objects
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match, stored_symmetry
from blender_addon.viewport import preview


def numbers(obj):
    return sorted(surface_points_on(bpy.context.scene, obj))


def mark(*objects):
    for number, obj in enumerate(objects, 1):
        api.set_landmark(bpy.context, obj, number, number)


def test_clearing_removes_only_stored_data(source, target):
    add_uv_map(source.data, "UVMap")
    match_objects(bpy.context, source, target, k_final=30)
    transfer_objects(bpy.context, source, target, ("uv_maps",))
    target["own"] = 1
    before = snapshot_file()
    kept = set(dict(target.data.items())) | {a.name for a in target.data.attributes if "zoomout" in a.name}
    assert {"zoomout_match", "zoomout_candidates", "zoomout_report", "zoomout_triangle"} <= kept
    mark(source, target, target)
    assert bpy.ops.zoomout.preview(kind="PLACES") == {"FINISHED"}
    assert bpy.ops.zoomout.clear_match_data() == {"FINISHED"}
    after = snapshot_file()
    for name in kept:
        for part in ("attributes", "properties"):
            before[1]["Target"][part].pop(name, None)
    assert after == before
    assert "UVMap" in target.data.uv_layers
    assert not bpy.context.scene.zoomout.landmarks  # those of the source, too, which was selected
    assert preview.current() is None


def test_clearing_removes_a_symmetry(body):
    assert bpy.ops.zoomout.clear_match_data() == {"FINISHED"}
    assert stored_symmetry.description(body.data) is None
    assert not any("zoomout" in attribute.name for attribute in body.data.attributes)


def test_clearing_keeps_data_of_other_objects(source, target):
    keep_true_match(target)
    other = ellipsoid("Other", 3)
    mark(source, target, other)
    assert bpy.ops.zoomout.preview(kind="PLACES") == {"FINISHED"}
    assert clear_match_data(bpy.context, [other]) == "Cleared 0 meshes and 1 landmark"
    assert stored_match.description(target.data) is not None
    assert (numbers(source), numbers(target), numbers(other)) == ([1], [2], [])
    assert preview.current() is not None


def test_clearing_removes_remains_of_a_match(source, target):
    keep_true_match(target)
    target.data.attributes.remove(target.data.attributes["zoomout_confidence"])
    assert clear_match_data(bpy.context, [target, source]) == "Cleared 1 mesh and 0 landmarks"
    assert stored_match.PROPERTY not in target.data
    assert "zoomout_triangle" not in target.data.attributes


def test_clearing_the_file_includes_unused_meshes_and_scenes(source, target):
    keep_true_match(target)
    loose = target.data.copy()
    loose.use_fake_user = True
    elsewhere = bpy.data.scenes.new("Elsewhere")
    elsewhere.collection.objects.link(target)
    mark(source)
    landmark = elsewhere.zoomout.landmarks.add()
    landmark.places.add().object = target
    activate(source)
    assert bpy.ops.zoomout.clear_match_data() == {"FINISHED"}
    assert stored_match.PROPERTY in target.data
    assert bpy.ops.zoomout.clear_match_data(whole_file=True) == {"FINISHED"}
    assert stored_match.PROPERTY not in target.data
    assert stored_match.PROPERTY not in loose
    assert not elsewhere.zoomout.landmarks


def test_clearing_is_one_undo_step(source, target):
    keep_true_match(target)
    mark(source)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.zoomout.clear_match_data("EXEC_DEFAULT", True)
    bpy.ops.ed.undo()
    target = bpy.data.objects["Target"]
    assert stored_match.description(target.data) is not None
    assert len(bpy.context.scene.zoomout.landmarks) == 1


def test_mesh_in_edit_mode_is_refused_and_nothing_is_removed(source, target):
    keep_true_match(target)
    activate(source)
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(zo.MeshError, match="The mesh 'Source' is being edited: leave its Edit Mode"):
        clear_match_data(bpy.context, [target, source])
    assert stored_match.description(target.data) is not None


def test_operator_leaves_and_reenters_edit_mode(source, target):
    keep_true_match(target)
    bpy.ops.object.mode_set(mode="EDIT")
    assert bpy.ops.zoomout.clear_match_data() == {"FINISHED"}
    assert bpy.context.mode == "EDIT_MESH"
    assert stored_match.PROPERTY not in target.data


def test_landmarks_vanish_with_their_object(source, target):
    mark(source, target, target)
    scene = bpy.context.scene
    activate(target)
    target.name = "Renamed"
    bpy.context.view_layer.update()
    assert numbers(target) == [2, 3]
    bpy.ops.object.delete()
    bpy.context.view_layer.update()
    assert [landmark.number for landmark in scene.zoomout.landmarks] == [1]


def test_landmarks_return_with_a_restored_object(source, target):
    mark(source, target)
    activate(target)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.object.delete("EXEC_DEFAULT", True)
    bpy.context.view_layer.update()
    assert len(bpy.context.scene.zoomout.landmarks) == 1
    bpy.ops.ed.undo()
    assert len(bpy.context.scene.zoomout.landmarks) == 2
    assert numbers(bpy.data.objects["Target"]) == [2]
