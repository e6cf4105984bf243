# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of the source's armature moves into a target of another build, with everything that makes it a rig."""

import bpy
import numpy as np
import pytest
from bent_tube import tube, weights_of
from mathutils import Euler, Matrix
from rigged import BUILD, POSE, in_target, mesh_object, other_build, visible_positions
from rigged import coarse_pose_target as pose_target
from rigged import coarse_source_and_rig as source_and_rig
from scenes import activate, link, snapshot
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import api, mesh_data
from blender_addon.mesh_data import read_rig_bones
from blender_addon.mesh_data.rigs.outfit_bones import edit_bones
from blender_addon.services import transfer

PLACE = Matrix.LocRotScale((5, -3, 2), Euler((0.2, 0.6, 2.0)), (0.5, 0.5, 0.5))


def match_again(target, at_rest):
    """Store the true match of a target that was changed."""
    target.data.update()
    bpy.context.view_layer.update()
    keep_true_match(target, at_rest)


def move(source, target, **binding):
    report = api.move_rig(bpy.context, source, target, api.Binding(**binding))
    assert not source.hide_get()  # the target is not at its place
    return report, bpy.data.objects[report["bound"]["armature"]]


def add_bone(armature, name, head, tail, parent=None, **options):
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.data.edit_bones.new(name)
    bone.head, bone.tail, bone.use_deform = head, tail, False
    bone.parent = armature.data.edit_bones.get(parent or "")
    for option, value in options.items():
        setattr(bone, option, value)
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("place", [None, PLACE], ids=["in place", "elsewhere"])
def test_bones_move_to_corresponding_places(place):
    source, armature = source_and_rig()
    target, _ = other_build(place)
    stood, before = visible_positions(target), snapshot(source)
    wanted = in_target(target, np.array([[0, 0, 2.0 * i] for i in range(4)]) * BUILD)
    report, made = move(source, target, shape="keep_shape")
    np.testing.assert_allclose(visible_positions(target), stood, atol=1e-4)
    bones = read_rig_bones(made)
    np.testing.assert_allclose(bones.heads, wanted[:3], atol=0.15)
    np.testing.assert_allclose(bones.tails, wanted[1:], atol=0.2)
    assert made is not armature
    assert target.parent == made
    assert [modifier.object for modifier in target.modifiers] == [made]
    assert report["bound"]["shape"] == "keep_shape"
    assert snapshot(source) == before


def test_the_action_plays_about_the_moved_joints():
    source, armature = source_and_rig()
    target, still = other_build()
    for bone in armature.pose.bones:
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = (0, 0, 0)
        bone.keyframe_insert("rotation_euler", frame=1)
        bone.rotation_euler = POSE.get(bone.name, (0, 0, 0))
        bone.keyframe_insert("rotation_euler", frame=9)
    _, made = move(source, target, shape="keep_shape")
    bpy.context.scene.frame_set(9)
    assert made.animation_data.action == armature.animation_data.action
    bones = read_rig_bones(made)
    transforms = np.array([np.array(made.pose.bones[name].matrix) for name in bones.names])
    rest = np.array([np.array(made.data.bones[name].matrix_local) for name in bones.names])
    moves = (np.array(made.matrix_world) @ transforms @ np.linalg.inv(np.array(made.matrix_world) @ rest))[:, :3]
    expected = np.einsum(
        "nb,bxy,ny->nx", weights_of(still / BUILD).toarray(), moves, np.column_stack([still, np.ones(len(still))])
    )
    assert np.linalg.norm(visible_positions(target) - expected, axis=1).mean() < 0.03
    turned = moves[2, :, :3] @ moves[1, :, :3].T
    original = [np.array(armature.pose.bones[name].matrix)[:3, :3] for name in ("Upper", "Middle")]
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) == pytest.approx(
        np.degrees(np.arccos((np.trace(original[0] @ original[1].T) - 1) / 2)), abs=2
    )


def test_the_motion_is_compared_with_the_source():
    source, armature = source_and_rig()
    target, _ = other_build(PLACE)
    _, made = move(source, target, shape="keep_shape")
    with pytest.raises(zo.MeshError, match="Nothing animates"):
        api.check_motion(bpy.context, target)
    upper = armature.pose.bones["Upper"]
    upper.keyframe_insert("rotation_quaternion", frame=1)
    upper.rotation_quaternion = Euler((0.5, 0, 0)).to_quaternion()
    upper.keyframe_insert("rotation_quaternion", frame=9)
    upper.rotation_quaternion = (1, 0, 0, 0)
    made.animation_data_create().action = armature.animation_data.action
    if hasattr(made.animation_data, "action_slot"):  # since Blender 4.4
        made.animation_data.action_slot = armature.animation_data.action_slot
    bpy.context.view_layer.update()
    activate(target)
    assert not api.check_motion(bpy.context, target).faults
    follow = made.pose.bones["Lower"].constraints.new("LIMIT_LOCATION")
    follow.use_max_y, follow.max_y, follow.owner_space = True, -1.0, "LOCAL"  # down along the bone
    found = api.check_motion(bpy.context, target)
    legs = made.data.bones["Middle"].head_local.z - made.data.bones["Lower"].head_local.z
    assert found.sinking == pytest.approx(1 / legs, rel=0.05)
    assert bpy.ops.zoomout.check_motion() == {"FINISHED"}
    target.modifiers.clear()
    target.parent = None
    with pytest.raises(zo.MeshError, match="not bound to the bones"):
        api.check_motion(bpy.context, target)


def test_a_posed_target_is_taken_to_rest_at_its_own_size():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    target.matrix_world = Matrix.Scale(2.0, 4)
    bpy.context.view_layer.update()
    report, made = move(source, target)
    assert report["bound"]["shape"] == "rest_pose"
    assert "Posed Shape" in target.data.shape_keys.key_blocks
    assert any("If it was at rest, bind it with Target Pose set to At Rest." in note for note in report["notes"])
    bones = read_rig_bones(made)
    np.testing.assert_allclose(np.linalg.norm(bones.tails - bones.heads, axis=1), 4, rtol=0.03)
    edges = [np.linalg.norm(np.diff(points[:40], axis=0), axis=1) for points in (visible_positions(target), at_rest)]
    np.testing.assert_allclose(np.median(edges[0] / edges[1]), 2, rtol=0.03)


def test_rolls_follow_the_surface():
    source, _ = source_and_rig()
    target, _ = other_build(Matrix.Rotation(0.8, 4, "Z"))
    _, made = move(source, target, shape="keep_shape")
    for name, upright in zip(*(lambda bones: (bones.names, bones.upright))(read_rig_bones(made)), strict=True):
        before = read_rig_bones(bpy.data.objects["Rig"])
        wanted = np.array(Matrix.Rotation(0.8, 3, "Z")) @ before.upright[before.names.index(name)]
        assert np.degrees(np.arccos(np.clip(upright @ wanted / np.linalg.norm(upright), -1, 1))) < 4


def test_constraints_drivers_shapes_and_collections_refer_to_the_copy():
    source, armature = source_and_rig()
    shape = mesh_object("Widget", tube(8, 5))
    armature.pose.bones["Middle"].custom_shape = shape
    constraint = armature.pose.bones["Upper"].constraints.new("COPY_ROTATION")
    constraint.target, constraint.subtarget, constraint.influence = armature, "Lower", 0.5
    stretch = armature.pose.bones["Upper"].constraints.new("STRETCH_TO")
    stretch.target, stretch.subtarget, stretch.rest_length = armature, "Lower", 7.0
    stretch.mute = True
    several = armature.pose.bones["Lower"].constraints.new("ARMATURE")
    several.mute = True
    several.targets.new().target = armature
    driver = armature.pose.bones["Lower"].driver_add("scale", 0).driver
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = armature, "location[0]"
    driver.expression = "1 + var"
    armature.data.collections.new("Hands").assign(armature.data.bones["Upper"])
    armature.data.bones["Lower"]["note"] = "kept"
    target, _ = other_build()
    _, made = move(source, target, shape="keep_shape")
    copied, stretched = made.pose.bones["Upper"].constraints
    assert (copied.target, copied.subtarget, copied.influence) == (made, "Lower", 0.5)
    assert stretched.rest_length != 7.0
    assert made.pose.bones["Lower"].constraints[0].targets[0].target == made
    assert made.pose.bones["Middle"].custom_shape == shape
    assert made.animation_data.drivers[0].driver.variables[0].targets[0].id == made
    assert [bone.name for bone in made.data.collections["Hands"].bones] == ["Upper"]
    assert made.data.bones["Lower"]["note"] == "kept"
    assert constraint.target == armature
    assert variable.targets[0].id == armature


def test_inverse_kinematics_keep_their_pole_angle():
    source, armature = source_and_rig()
    add_bone(armature, "Goal", (0, 0, 4), (0, 0.5, 4))
    add_bone(armature, "Pole", (0.1, 5, 2), (0.1, 6, 2))
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones["Lower"].tail = armature.data.edit_bones["Middle"].head = (0, 0.3, 2)
    bpy.ops.object.mode_set(mode="OBJECT")
    reach = armature.pose.bones["Middle"].constraints.new("IK")
    reach.target, reach.subtarget, reach.chain_count = armature, "Goal", 2
    reach.pole_target, reach.pole_subtarget = armature, "Pole"
    errors = {}
    for angle in np.radians(np.arange(-180, 180, 1.0)):
        reach.pole_angle = angle
        bpy.context.view_layer.update()
        errors[angle] = off_rest(armature)
    reach.pole_angle = min(errors, key=errors.get)
    bpy.context.view_layer.update()
    assert off_rest(armature) < 0.03
    target, _ = other_build(Matrix.Rotation(0.8, 4, "Z"))
    _, made = move(source, target, shape="keep_shape")
    assert made.pose.bones["Middle"].constraints[0].pole_target == made
    bpy.context.view_layer.update()
    assert off_rest(made) < 0.05


def off_rest(armature):
    """The largest difference of the axes of posed bones from those at rest."""
    return max(
        np.abs(np.array(bone.matrix.to_3x3()) - np.array(bone.bone.matrix_local.to_3x3())).max()
        for bone in armature.pose.bones
    )


def test_bones_at_one_place_stay_together():
    source, armature = source_and_rig()
    add_bone(armature, "Twist", (0, 0, 2), (0, 0, 3), "Lower")
    target, _ = other_build()
    _, made = move(source, target, shape="keep_shape")
    bones = made.data.bones
    np.testing.assert_allclose(bones["Twist"].head_local, bones["Middle"].head_local, atol=1e-5)


def test_bones_along_a_longer_one_stay_along_it():
    source, armature = source_and_rig()
    add_bone(armature, "Half", (0, 0, 3), (0, 0, 3.5), "Middle")
    target, still = other_build()
    bent = still + np.outer(0.1 * np.sin(2 * still[:, 2]), [1, 0, 0])
    target.data.vertices.foreach_set("co", bent.ravel())
    match_again(target, still / BUILD)
    _, made = move(source, target, shape="keep_shape")
    middle, half = made.data.bones["Middle"], made.data.bones["Half"]
    direction = (middle.tail_local - middle.head_local).normalized()
    assert (half.tail_local - half.head_local).normalized().dot(direction) > 0.99999
    assert (half.head_local - middle.head_local).cross(direction).length < 1e-4
    assert half.length / middle.length == pytest.approx(0.25, abs=1e-4)


def test_lengths_in_constraints_scale_with_the_build():
    source, armature = source_and_rig()
    limit = armature.pose.bones["Upper"].constraints.new("LIMIT_DISTANCE")
    limit.target, limit.subtarget, limit.distance = armature, "Lower", 4.5
    target, _ = other_build()
    _, made = move(source, target, shape="keep_shape")
    assert made.pose.bones["Upper"].constraints[0].distance == pytest.approx(1.5 * 4.5, rel=0.05)


def test_bones_turned_by_constraints_at_rest_are_noted():
    source, armature = source_and_rig()
    goal = link("Goal", None)
    goal.location = (0, 0, 12)
    look = armature.pose.bones["Upper"].constraints.new("DAMPED_TRACK")
    look.target = goal
    target, _ = other_build(Matrix.Translation((0, 5, 0)))
    report, made = move(source, target, shape="keep_shape")
    (note,) = [str(note) for note in report["notes"] if "At rest, constraints rotate" in str(note)]
    assert "'Upper'" in note
    assert set(mesh_data.bends_at_rest(armature, made)) == {"Upper"}


def test_nla_actions_block_moving_only_if_they_move_the_armature():
    _, armature = source_and_rig()
    for path, moves in (('pose.bones["Upper"].location', False), ("location", True)):
        armature.keyframe_insert(path, frame=1)
        animation = armature.animation_data
        animation.nla_tracks.new().strips.new("Take", 1, animation.action)
        animation.action = None
        assert mesh_data.moves_by_itself(armature) == moves


def test_immovable_rigs_are_refused_and_nothing_is_written():
    source, armature = source_and_rig()
    target, _ = other_build()
    armature.keyframe_insert("location", frame=1)
    before, count = snapshot(target), len(bpy.data.armatures)
    with pytest.raises(zo.MeshError, match="is animated"):
        move(source, target)
    armature.animation_data_clear()
    other = link("Second", bpy.data.armatures.new("Second"))
    source.modifiers.new("Second", "ARMATURE").object = other
    with pytest.raises(zo.MeshError, match="several armatures"):
        move(source, target)
    source.modifiers.remove(source.modifiers["Second"])
    holder = link("Holder", None)
    limit = armature.constraints.new("COPY_LOCATION")
    limit.target = holder
    target.matrix_world = Matrix.Translation((3, 0, 0))
    bpy.context.view_layer.update()
    with pytest.raises(zo.MeshError, match="determine the transform"):
        move(source, target, shape="keep_shape")
    target.matrix_world = Matrix()
    bpy.context.view_layer.update()
    assert snapshot(target) == before
    assert len(bpy.data.armatures) == count + 1


def test_child_of_constraints_with_an_inverse_are_noted():
    source, armature = source_and_rig()
    child = armature.pose.bones["Upper"].constraints.new("CHILD_OF")
    child.target, child.mute, child.inverse_matrix = armature, True, Matrix.Translation((1, 0, 0))
    target, _ = other_build()
    report, _ = move(source, target, shape="keep_shape")
    assert any("The Child Of constraint of 'Upper' has the inverse" in str(note) for note in report["notes"])


def test_the_button_binds_the_active_mesh_in_one_step():
    source, armature = source_and_rig()
    target, _ = other_build(PLACE)
    activate(target)
    source.select_set(True)
    stood = visible_positions(target)
    assert bpy.ops.zoomout.move_rig(binding="KEEP_SHAPE") == {"FINISHED"}
    assert target.parent.type == "ARMATURE"
    assert target.parent != armature
    assert bpy.context.view_layer.objects.active == target
    np.testing.assert_allclose(visible_positions(target), stood, atol=1e-4)
    assert not source.hide_get()


def test_a_disabled_armature_gives_a_visible_rig():
    source, armature = source_and_rig()
    target, _ = other_build()
    armature.hide_viewport = True
    bpy.context.view_layer.update()
    _, made = move(source, target, shape="keep_shape")
    assert made.visible_get()
    assert armature.hide_viewport
    np.testing.assert_allclose(read_rig_bones(made).heads[1], np.array([0, 0, 2.0]) * BUILD, atol=0.15)


def test_bones_can_be_edited_in_an_excluded_collection():
    _, armature = source_and_rig()
    hidden = bpy.data.collections.new("Rigs")
    bpy.context.scene.collection.children.link(hidden)
    for collection in armature.users_collection:
        collection.objects.unlink(armature)
    hidden.objects.link(armature)
    bpy.context.view_layer.layer_collection.children["Rigs"].exclude = True
    with edit_bones(bpy.context, armature) as bones:
        bones["Upper"].tail.x += 1
    assert armature.data.bones["Upper"].tail_local.x == pytest.approx(1)
    assert armature.users_collection == (hidden,)


def test_bones_that_move_nothing_are_noted():
    source, _ = source_and_rig()
    still = tube(around=11, along=33, turned=0.4)
    faces = [face for face in still.triangles.tolist() if still.vertices[face, 2].max() < 2.5]  # below "Upper"
    kept, corners = np.unique(faces, return_inverse=True)
    target = mesh_object("Target", zo.Surface(still.vertices[kept] * BUILD, corners.reshape(-1, 3)))
    keep_true_match(target, still.vertices[kept])
    report, made = move(source, target, shape="keep_shape")
    assert sum("The joint 'Upper' moves nothing" in note for note in report["notes"]) == 1
    assert read_rig_bones(made).heads[2, 2] > target.data.vertices[0].co.z  # beyond the part


def test_a_failure_leaves_no_armature(monkeypatch):
    source, _ = source_and_rig()
    target, _ = other_build()
    before = set(bpy.data.armatures), set(bpy.data.objects)

    def fail(*_):
        raise RuntimeError("as if the match could not be kept")

    monkeypatch.setattr(transfer, "keep_match", fail)
    with pytest.raises(RuntimeError):
        move(source, target, shape="keep_shape")
    assert (set(bpy.data.armatures), set(bpy.data.objects)) == before


@pytest.mark.parametrize("elsewhere", [True, False])
def test_an_armature_outside_the_scene_is_named(elsewhere):
    source, armature = source_and_rig()
    target, _ = other_build()
    if elsewhere:
        bpy.data.scenes.new("Other").collection.objects.link(armature)
    bpy.context.scene.collection.objects.unlink(armature)
    before = snapshot(target)
    for call in (api.move_rig, api.bind_to_rig):
        with pytest.raises(zo.MeshError, match="The armature 'Rig' of 'Source' is not in this scene: link it"):
            call(bpy.context, source, target)
    assert snapshot(target) == before
