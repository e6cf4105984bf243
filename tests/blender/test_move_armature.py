# SPDX-License-Identifier: GPL-3.0-or-later
"""An armature without bone weights, such as a metarig, moves into a target by the surface around its bones."""

import bpy
import numpy as np
import pytest
from bent_tube import tube
from mathutils import Euler, Matrix
from rigged import BUILD, in_target, mesh_object, other_build, rig, source_and_rig, visible_positions
from scenes import activate, snapshot

import zoomout_core as zo
from blender_addon import api
from blender_addon.mesh_data import read_rig_bones
from blender_addon.services.binding import loose_armature

PLACE = Matrix.LocRotScale((5, -3, 2), Euler((0.2, 0.6, 2.0)), (0.5, 0.5, 0.5))
JOINTS = np.array([[0, 0, 2.0 * i] for i in range(4)])


@pytest.fixture
def plan():
    """An armature inside a mesh that it does not deform."""
    armature = rig("Plan")
    return mesh_object("Source", tube(20, 61)), armature


def select(target, *others):
    activate(target)
    for obj in others:
        obj.select_set(True)


@pytest.mark.parametrize("place", [None, PLACE], ids=["in place", "elsewhere"])
def test_bones_follow_the_surface_around_them(plan, place):
    source, armature = plan
    target, _ = other_build(place)
    before, seen = (snapshot(source), read_rig_bones(armature).heads), visible_positions(target)
    moved = api.move_armature(bpy.context, armature, source, target)
    made = bpy.data.objects[moved.copy]
    bones, wanted = read_rig_bones(made), in_target(target, JOINTS * BUILD)
    np.testing.assert_allclose(bones.heads, wanted[:3], atol=0.15)
    np.testing.assert_allclose(bones.tails, wanted[1:], atol=0.2)
    assert made.matrix_world.to_euler() == armature.matrix_world.to_euler()
    assert made.matrix_world.translation == target.matrix_world.translation
    np.testing.assert_array_equal(visible_positions(target), seen)
    assert target.parent is None
    assert not target.modifiers
    assert not target.vertex_groups
    assert snapshot(source) == before[0]
    np.testing.assert_array_equal(read_rig_bones(armature).heads, before[1])


def test_the_button_moves_the_selected_armature(plan):
    source, armature = plan
    target, _ = other_build()
    select(target, source, armature)
    assert bpy.ops.zoomout.move_rig() == {"FINISHED"}
    assert f"{armature.name} {target.name}" in bpy.context.scene.objects


def test_the_button_moves_an_armature_that_binds_the_source_without_weights(plan):
    source, armature = plan
    source.modifiers.new("Skeleton", "ARMATURE").object = armature
    target, _ = other_build()
    select(target, source)
    assert bpy.ops.zoomout.move_rig() == {"FINISHED"}
    assert f"{armature.name} {target.name}" in bpy.context.scene.objects
    assert not target.modifiers


def test_a_source_with_weights_binds_the_target_although_its_armature_is_selected():
    source, armature = source_and_rig()
    target, _ = other_build()
    select(target, source, armature)
    assert bpy.ops.zoomout.move_rig(binding="KEEP_SHAPE") == {"FINISHED"}
    assert target.parent.name == f"{armature.name} {target.name}"


def test_without_an_armature_the_button_says_how_to_choose_one(plan):
    source, _ = plan
    target, _ = other_build()
    select(target, source)
    with pytest.raises(RuntimeError, match="select the armature inside it"):
        bpy.ops.zoomout.move_rig()
    with pytest.raises(zo.MeshError, match="No bone weights of 'Source'"):
        api.move_rig(bpy.context, source, target)


def test_an_animated_armature_is_refused(plan):
    source, armature = plan
    target, _ = other_build()
    armature.keyframe_insert("location", frame=1)
    with pytest.raises(zo.MeshError, match="is animated"):
        api.move_armature(bpy.context, armature, source, target)


def test_an_object_that_is_no_armature_of_the_scene_is_refused(plan):
    source, armature = plan
    target, _ = other_build()
    with pytest.raises(zo.MeshError, match="The scene has no armature 'Source'"):
        api.move_armature(bpy.context, source, source, target)
    armature.users_collection[0].objects.unlink(armature)
    with pytest.raises(zo.MeshError, match="The scene has no armature 'Plan'"):
        api.move_armature(bpy.context, armature, source, target)


def test_a_failure_leaves_no_copy(plan, monkeypatch):
    source, armature = plan
    target, _ = other_build()
    before = set(bpy.data.objects), set(bpy.data.armatures)

    def fail(*_):
        raise RuntimeError

    monkeypatch.setattr(loose_armature.mesh_data, "bends_at_rest", fail)
    with pytest.raises(RuntimeError):
        api.move_armature(bpy.context, armature, source, target)
    assert (set(bpy.data.objects), set(bpy.data.armatures)) == before
