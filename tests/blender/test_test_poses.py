# SPDX-License-Identifier: GPL-3.0-or-later
"""Test poses rotate the bones like the check of a binding, and leave the pose as it was."""

import bpy
import numpy as np
import pytest
from playing import playing
from rigged import POSE, set_pose, source_and_rig
from scenes import activate, snapshot_file

from blender_addon.mesh_data import HeldPose, read_bones, turn_bones
from blender_addon.operators.base import play_operator as play
from blender_addon.operators.base import running_operators
from blender_addon.operators.play_test_poses import ZOOMOUT_OT_test_poses
from zoomout_core.transfer.rigging.poses import extreme_poses, extreme_turns


@pytest.fixture
def rigged(empty_scene):
    source, armature = source_and_rig()
    armature.matrix_world = [[0, -2, 0, 0], [2, 0, 0, 0], [0, 0, 2, 0], [3, 0, 1, 1]]
    bpy.context.view_layer.update()
    activate(source)
    return source, armature


@pytest.fixture
def testing(rigged):
    operator = playing(ZOOMOUT_OT_test_poses)
    yield operator
    running_operators.end(operator)


def transforms_of(source, armature):
    """(b, 3, 4) transforms of the bones from rest, in world space."""
    world = armature.matrix_world
    names = read_bones(source).names
    found = [
        world @ armature.pose.bones[name].matrix @ (world @ armature.data.bones[name].matrix_local).inverted()
        for name in names
    ]
    return np.array(found)[:, :3]


def test_bones_turn_as_in_the_check_of_a_binding(rigged):
    source, armature = rigged
    bones = read_bones(source)
    expected = extreme_poses(bones.heads, bones.parents)
    for turns, pose in zip(extreme_turns(bones.parents), expected, strict=True):
        turn_bones(armature, dict(zip(bones.names, turns, strict=True)))
        bpy.context.view_layer.update()
        np.testing.assert_allclose(transforms_of(source, armature), pose, atol=1e-5)


def test_a_pose_is_restored_to_the_same_channels(rigged):
    _, armature = rigged
    set_pose(armature, POSE)
    armature.pose.bones["Middle"].rotation_euler.x = 8.0  # more than a full turn, which no matrix tells
    bpy.context.view_layer.update()
    before, held = snapshot_file(), HeldPose(armature)
    turn_bones(armature, {"Upper": np.array([0.5, 0, 0])})
    held.restore(armature)
    bpy.context.view_layer.update()
    assert snapshot_file() == before
    assert armature.pose.bones["Middle"].rotation_euler.x == 8.0


def test_poses_play_until_escape_and_only_navigation_is_allowed(rigged, testing, monkeypatch):
    source, armature = rigged
    set_pose(armature, POSE)
    before = [tuple(bone.rotation_euler) for bone in armature.pose.bones]
    now = [100.0]
    monkeypatch.setattr(play, "monotonic", lambda: now[0])
    assert testing.invoke(testing.window, None) == {"RUNNING_MODAL"}
    assert testing.window.status.startswith("Test pose 1 of 12")
    now[0] += 1.5
    assert testing.event("TIMER") == {"PASS_THROUGH"}
    assert testing.window.status.startswith("Test pose 2 of 12")
    bpy.context.view_layer.update()
    bones = read_bones(source)
    np.testing.assert_allclose(transforms_of(source, armature), extreme_poses(bones.heads, bones.parents)[1], atol=1e-5)
    assert testing.event("MIDDLEMOUSE") == {"PASS_THROUGH"}
    assert testing.event("Z") == {"RUNNING_MODAL"}
    assert testing.event("ESC") == {"CANCELLED"}
    assert [tuple(bone.rotation_euler) for bone in armature.pose.bones] == before
    assert (testing.window.timers, testing.window.status) == (0, None)


def test_disabling_the_extension_restores_the_pose(rigged, testing):
    _, armature = rigged
    set_pose(armature, POSE)
    before = [tuple(bone.rotation_euler) for bone in armature.pose.bones]
    testing.invoke(testing.window, None)
    testing.cancel(testing.window)
    assert not running_operators._running
    assert [tuple(bone.rotation_euler) for bone in armature.pose.bones] == before


def test_removed_armature_is_ignored(rigged, testing):
    _, armature = rigged
    testing.invoke(testing.window, None)
    bpy.data.objects.remove(armature)
    assert testing.event("TIMER") == {"PASS_THROUGH"}
    assert testing.event("ESC") == {"CANCELLED"}


def test_unposable_meshes_and_rigs_are_refused(rigged, source):
    body, armature = rigged
    activate(source)
    assert not bpy.ops.zoomout.test_poses.poll()
    activate(body)
    assert bpy.ops.zoomout.test_poses.poll()
    for bone in armature.pose.bones:
        bone.constraints.new("LIMIT_ROTATION")
    assert not bpy.ops.zoomout.test_poses.poll()
    armature.pose.bones["Upper"].constraints[0].enabled = False
    assert bpy.ops.zoomout.test_poses.poll()
