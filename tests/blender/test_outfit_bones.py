# SPDX-License-Identifier: GPL-3.0-or-later
"""A target with its own armature is dressed: the outfit is bound to it, and brings its own bones."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bent_tube import tube, weights_of
from rigged import BONES, mesh_object, pose_target, rig, set_pose, source_and_rig, visible_positions
from scenes import activate, positions, set_weights
from test_dress_objects import ring, side, sleeve

import zoomout_core as zo
from blender_addon import api
from blender_addon.mesh_data import read_weights
from blender_addon.mesh_data.rigs import outfit_bones
from blender_addon.services.dressing import fit, worn_weights

OTHER_NAMES = ("mixamorig:lower", "Bone.001", "Upper")


def edit(armature, change):
    """Call a function with the edit bones of an armature."""
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    change(armature.data.edit_bones)
    bpy.ops.object.mode_set(mode="OBJECT")


def tail_and_chain(armature):
    """A tail that sticks out of the tube's middle along x, with a chain of two bones below the middle bone."""

    def add(bones):
        above = bones["Middle"]
        for number in range(2):
            made = bones.new(f"Tail.{number}")
            made.head, made.tail = (0.7 + number, 0, 3), (1.7 + number, 0, 3)
            made.align_roll((0, 1, 0))
            made.parent, made.use_connect, above = above, number > 0, made

    edit(armature, add)
    straight = tube(around=10, along=21)
    points = straight.vertices[:, [2, 1, 0]] * [1 / 3, 0.2, -0.2] + [0.7, 0, 3]
    tail = mesh_object("Tail", zo.Surface(points, straight.triangles))
    outer = positions(tail.data)[:, 0] > 1.7
    set_weights(tail, "Tail.0", (~outer).astype(float))
    set_weights(tail, "Tail.1", outer.astype(float))
    tail.parent = armature
    tail.modifiers.new("Skeleton", "ARMATURE").object = armature
    constraint = armature.pose.bones["Tail.1"].constraints.new("DAMPED_TRACK")
    constraint.target, constraint.subtarget, constraint.influence = armature, "Lower", 0.0
    bpy.context.view_layer.update()
    return tail


def own_target(body, armature, joints=0.0):
    """A target in rest pose, bound to its own armature with other names of bones; its skin bends above these."""
    target, _ = pose_target(body, armature, {})
    other = rig("Other Rig", OTHER_NAMES)
    for name, column in zip(OTHER_NAMES, raised_weights(positions(target.data), joints).T, strict=True):
        set_weights(target, name, column)
    target.parent = other
    target.modifiers.new("Skeleton", "ARMATURE").object = other
    bpy.context.view_layer.update()
    return target, other


def test_clothes_are_bound_to_the_targets_own_armature():
    body, armature = source_and_rig()
    cloth, prop = sleeve(armature), ring(armature)
    target, other = own_target(body, armature)
    before = [bone.name for bone in armature.data.bones]
    report = api.dress(bpy.context, body, target, [cloth, prop])
    copy, hung = (bpy.data.objects[report["objects"][name]] for name in ("Sleeve", "Ring"))
    assert (copy.parent, [modifier.object for modifier in copy.modifiers]) == (other, [other])
    assert {group.name for group in copy.vertex_groups} == set(OTHER_NAMES)
    assert {group.name for group in cloth.vertex_groups} == set(BONES)
    assert (hung.parent, hung.parent_type, hung.parent_bone) == (other, "BONE", "Upper")
    assert [bone.name for bone in armature.data.bones] == before
    assert [bone.name for bone in other.data.bones] == list(OTHER_NAMES)
    assert any("bound to 'Other Rig', to which 0 bones" in note for note in report["notes"])
    at_rest = np.linalg.norm((visible_positions(hung) - visible_positions(prop)).mean(axis=0))
    assert at_rest < 0.15
    for pose in ({}, {"Bone.001": (0.4, 0, 0), "Upper": (0, 0.3, 0)}):
        set_pose(other, pose)
        assert (side(visible_positions(copy), target) < 0).mean() < 0.02


def test_the_joints_of_both_armatures_place_the_clothes(monkeypatch):
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, _ = own_target(body, armature)
    given = []

    def align(surface, shape, skin, joints):
        given.append((surface, skin, joints))
        return shape + np.array([0, 0, 5])

    before = positions(bpy.data.objects[api.dress(bpy.context, body, target, [cloth])["objects"]["Sleeve"]].data)
    monkeypatch.setattr(fit, "align_joints", align)
    copy = bpy.data.objects[api.dress(bpy.context, body, target, [cloth])["objects"]["Sleeve"]]
    np.testing.assert_allclose((positions(copy.data) - before).mean(axis=0), [0, 0, 5], atol=0.5)
    surface, _, joints = given[-1]
    # Partners by name, and their parents.
    np.testing.assert_allclose(joints.before, joints.after, atol=1e-5)
    assert joints.parents.tolist() == [-1, 0, 1]
    assert joints.weights.shape == (len(surface.vertices), 3)
    np.testing.assert_allclose(joints.weights.sum(axis=1), 1, atol=1e-5)


def test_the_weights_follow_those_of_the_target():
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    cloth.vertex_groups.new(name="Pinned").add([0, 1, 2], 0.5, "REPLACE")
    target, _ = own_target(body, armature, joints=0.5)
    report = api.dress(bpy.context, body, target, [cloth])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    found = read_weights(copy, copy.data)
    groups = dict(zip(found.labels, found.values.toarray().T, strict=True))
    weights = np.column_stack([groups[name] for name in OTHER_NAMES])
    wanted, before = raised_weights(positions(cloth.data), 0.5), weights_of(positions(cloth.data)).toarray()
    assert np.abs(weights - wanted).mean() < 0.2 * np.abs(before - wanted).mean()
    assert np.flatnonzero(groups["Pinned"]).tolist() == [0, 1, 2]
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)


def test_copies_are_displaced_for_poses_of_the_target(monkeypatch):
    """By the weights that they get, and with their own bones, which move with those above them."""
    body, armature = source_and_rig()
    cloth, tail = sleeve(armature), tail_and_chain(armature)
    target, _ = own_target(body, armature, joints=0.5)
    given = []

    def displace(dressed, *rest):
        given.extend(rest)
        return replace(dressed, vertices=tuple(points + np.array([0, 0, 0.25]) for points in dressed.vertices))

    monkeypatch.setattr(worn_weights, "clear_in_poses", displace)
    report = api.dress(bpy.context, body, target, [cloth, tail])
    copies = [bpy.data.objects[report["objects"][name]] for name in ("Sleeve", "Tail")]
    (weights, poses), of_copies = given
    np.testing.assert_allclose(weights.toarray()[:, :3], raised_weights(positions(target.data), 0.5), atol=1e-5)
    names = [*OTHER_NAMES, "Tail.0", "Tail.1"]
    for copy, found in zip(copies, of_copies, strict=True):
        groups = read_weights(copy, copy.data)
        np.testing.assert_allclose(
            found.toarray()[:, [names.index(each) for each in groups.labels]], groups.values.toarray(), atol=1e-5
        )
    assert poses.shape[1:] == (5, 3, 4)
    np.testing.assert_array_equal(poses[:, 3:], poses[:, [1, 1]])
    assert np.abs(poses - np.eye(3, 4)).max() > 0.1
    above = visible_positions(copies[0])[:, 2].mean() - visible_positions(cloth)[:, 2].mean()
    assert above == pytest.approx(0.25, abs=0.1)


def test_copies_on_a_target_without_weights_are_not_displaced(monkeypatch):
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, _ = own_target(body, armature)
    target.vertex_groups.clear()
    monkeypatch.setattr(worn_weights, "clear_in_poses", lambda *_: pytest.fail("they were displaced"))
    assert api.dress(bpy.context, body, target, [cloth])["objects"]


def raised_weights(points, height):
    """(n, 3) weights of a tube that bends at a height above its joints."""
    return weights_of(points - [0, 0, height]).toarray()


def test_outfit_bones_are_added_to_the_armature():
    body, armature = source_and_rig()
    tail = tail_and_chain(armature)
    target, other = own_target(body, armature)
    report = api.dress(bpy.context, body, target, [tail])
    copy = bpy.data.objects[report["objects"]["Tail"]]
    bones = other.data.bones
    assert bones.keys() == [*OTHER_NAMES, "Tail.0", "Tail.1"]
    assert (bones["Tail.0"].parent.name, bones["Tail.1"].parent.name) == ("Bone.001", "Tail.0")
    assert (bones["Tail.0"].use_connect, bones["Tail.1"].use_connect) == (False, True)
    for name in ("Tail.0", "Tail.1"):
        np.testing.assert_allclose(bones[name].matrix_local, armature.data.bones[name].matrix_local, atol=0.05)
    (constraint,) = other.pose.bones["Tail.1"].constraints
    assert (constraint.type, constraint.target, constraint.subtarget) == ("DAMPED_TRACK", other, OTHER_NAMES[0])
    groups = {group.name: group.index for group in copy.vertex_groups}
    assert list(groups) == ["Tail.0", "Tail.1"]
    before = visible_positions(copy)
    set_pose(other, {"Tail.1": (0, 0, 0.5)})
    moved = np.linalg.norm(visible_positions(copy) - before, axis=1)
    outer = positions(tail.data)[:, 0] > 1.7
    assert moved[~outer].max() < 1e-5 < moved[outer].max()
    assert any("to which 2 bones of their own were added" in note for note in report["notes"])


def test_failed_constraint_copy_restores_the_armature(monkeypatch):
    body, armature = source_and_rig()
    tail = tail_and_chain(armature)
    target, other = own_target(body, armature)
    copy_constraints = outfit_bones._copy_constraints

    def fail_at_the_end(source, target, name, pairs):
        if name == "Tail.1" and source == armature:
            raise RuntimeError("out of order")
        copy_constraints(source, target, name, pairs)

    def dress():
        monkeypatch.setattr(outfit_bones, "_copy_constraints", fail_at_the_end)
        with pytest.raises(RuntimeError, match="out of order"):
            api.dress(bpy.context, body, target, [tail])
        monkeypatch.undo()

    other.data["avatar"] = {"version": 1}  # as add-ons keep their settings
    counts = len(bpy.data.objects), len(bpy.data.armatures)
    dress()
    assert other.data.bones.keys() == list(OTHER_NAMES)
    assert other.data["avatar"]["version"] == 1
    assert (len(bpy.data.objects), len(bpy.data.armatures)) == counts
    api.dress(bpy.context, body, target, [tail])
    assert other.data["avatar"]["version"] == 1
    counts, name = (len(bpy.data.objects), len(bpy.data.armatures)), other.data.name
    places = {bone.name: np.array(bone.matrix_local) for bone in other.data.bones}
    dress()
    assert (len(bpy.data.objects), len(bpy.data.armatures), other.data.name) == (*counts, name)
    assert other.data.bones.keys() == [*OTHER_NAMES, "Tail.0", "Tail.1"]
    for bone in other.data.bones:
        np.testing.assert_array_equal(bone.matrix_local, places[bone.name])
    (constraint,) = other.pose.bones["Tail.1"].constraints
    assert (constraint.type, constraint.target, constraint.subtarget) == ("DAMPED_TRACK", other, OTHER_NAMES[0])


def test_the_new_bones_can_be_undone():
    body, armature = source_and_rig()
    tail = tail_and_chain(armature)
    target, other = own_target(body, armature)
    names = target.name, other.name
    bpy.ops.ed.undo_push(message="Before")
    api.dress(bpy.context, body, target, [tail])
    bpy.ops.ed.undo_push(message="Dress")
    assert len(bpy.data.objects[names[1]].data.bones) == 5
    bpy.ops.ed.undo()
    other = bpy.data.objects[names[1]]
    assert other.data.bones.keys() == list(OTHER_NAMES)
    bpy.ops.ed.redo()
    other = bpy.data.objects[names[1]]
    assert other.data.bones.keys() == [*OTHER_NAMES, "Tail.0", "Tail.1"]
    assert len(other.pose.bones["Tail.1"].constraints) == 1


@pytest.mark.slow
def test_dressing_again_replaces_the_bones():
    body, armature = source_and_rig()
    tail = tail_and_chain(armature)
    target, other = own_target(body, armature)
    activate(target)
    for _ in range(2):
        api.dress(bpy.context, body, target, [tail])
        assert other.data.bones.keys() == [*OTHER_NAMES, "Tail.0", "Tail.1"]
        assert len(other.pose.bones["Tail.1"].constraints) == 1
    assert bpy.context.view_layer.objects.active == target
    assert bpy.context.mode == "OBJECT"


def test_bones_without_a_partner_are_reported():
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, other = own_target(body, armature)

    def shift(bones):
        bones.remove(bones["Bone.001"])

    edit(other, shift)
    report = api.dress(bpy.context, body, target, [cloth])
    assert any("moves the objects, 'Middle', has no partner" in note for note in report["notes"])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    assert "Middle" in copy.vertex_groups


def test_existing_bones_of_the_target_are_unchanged():
    body, armature = source_and_rig()
    tail = tail_and_chain(armature)
    target, other = own_target(body, armature)

    def add(bones):
        made = bones.new("Tail.1")
        made.head, made.tail = (1, 2, 3), (2, 2, 3)

    edit(other, add)
    api.dress(bpy.context, body, target, [tail])
    assert set(other.data.bones.keys()) == {*OTHER_NAMES, "Tail.0", "Tail.1"}
    np.testing.assert_allclose(other.data.bones["Tail.1"].head_local, (1, 2, 3))


def test_an_armature_that_cannot_be_changed_leaves_the_copies_unbound():
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, other = own_target(body, armature)
    for collection in other.users_collection:
        collection.objects.unlink(other)
    report = api.dress(bpy.context, body, target, [cloth])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    assert copy.parent == target
    assert any("is not bound to the armature of 'Source'" in note for note in report["notes"])


def test_bones_of_hidden_skin_do_not_belong_to_the_outfit():
    """Bodies often lack the skin below trousers, whose bones have other names in the target's armature."""
    humanoid = ("Hips", "Spine", "Chest", "Neck", "Head")
    of_source = *humanoid, *(f"{side}{bone}" for side in ("Left", "Right") for bone in ("UpperLeg", "LowerLeg", "Foot"))
    of_target = (
        "Hips",
        "Spine",
        "Spine1",
        "Neck",
        "Head",
        *(f"{side}{bone}" for side in ("Left", "Right") for bone in ("UpLeg", "Leg", "Foot")),
    )
    armature, other = (rig(name, names) for name, names in (("Rig", (*of_source, "Skirt")), ("Other Rig", of_target)))
    body, trousers = (mesh_object(name, tube(around=4, along=3)) for name in ("Body", "Trousers"))
    whole = np.ones(len(body.data.vertices))
    set_weights(body, "Hips", whole)
    for bone in ("LeftUpperLeg", "Skirt"):
        set_weights(trousers, bone, whole)
    found = outfit_bones.read_outfit_bones(armature, other, [body], [trousers])
    assert found.names == ("Skirt",)
