# SPDX-License-Identifier: GPL-3.0-or-later
"""A part of a target gets bones and weights of a second source, below the bones of its own armature."""

import bpy
import numpy as np
import pytest
from bent_tube import tube, weights_of
from rigged import mesh_object, rig, set_pose, source_and_rig, visible_positions
from scenes import activate, set_weights, snapshot, weight_array
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import api
from blender_addon.services.binding import part

# The build of the target: longer and thinner.
BUILD = np.array([0.8, 0.8, 1.5])


def head_source():
    """A tube with the bones Lower, Head and Jaw, one above the other."""
    source, armature = source_and_rig(around=14, along=43)
    for old, new in (("Middle", "Head"), ("Upper", "Jaw")):
        armature.data.bones[old].name = new
    assert [group.name for group in source.vertex_groups] == ["Lower", "Head", "Jaw"]
    return source, armature


def rigged_target(names=("Lower", "Head")):
    """A longer tube with its own two bones, and the true weights of the source's bones."""
    still = tube(around=11, along=33, turned=0.4)
    target = mesh_object("Target", still.with_vertices(still.vertices * BUILD))
    armature = rig("Body", names)
    for number, bone in enumerate(edit(armature)):
        bone.head, bone.tail = (0, 0, 3.0 * number), (0, 0, 3.0 * number + 3)
    bpy.ops.object.mode_set(mode="OBJECT")
    weights = weights_of(still.vertices).toarray()
    set_weights(target, names[0], weights[:, 0])
    set_weights(target, names[1], weights[:, 1] + weights[:, 2])
    target.parent = armature
    target.modifiers.new("Skeleton", "ARMATURE").object = armature
    bpy.context.view_layer.update()
    keep_true_match(target, still.vertices)
    return target, armature, weights


def edit(armature):
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    return armature.data.edit_bones


def test_bones_of_a_part_are_added_in_their_places_and_move_it():
    source, of_source = head_source()
    constraint = of_source.pose.bones["Jaw"].constraints.new("COPY_SCALE")
    constraint.target, constraint.subtarget = of_source, "Head"
    target, armature, weights = rigged_target()
    stood, before = visible_positions(target), snapshot(source)
    added = api.add_bones(bpy.context, source, target, "Head")
    assert (added.names, added.parent, added.shared) == (("Jaw",), "Head", 2)
    assert str(added.sentence) == (
        "1 bone added below 'Head'; the part received their weights, and those of 2 bones of both"
    )
    jaw = armature.data.bones["Jaw"]
    assert jaw.parent == armature.data.bones["Head"]
    np.testing.assert_allclose([jaw.head_local, jaw.tail_local], [[0, 0, 6], [0, 0, 9]], atol=0.2)
    copied = armature.pose.bones["Jaw"].constraints[0]
    assert (copied.target, copied.subtarget) == (armature, "Head")
    np.testing.assert_allclose(visible_positions(target), stood, atol=1e-5)
    mask = weights[:, 1] + weights[:, 2]
    np.testing.assert_allclose(weight_array(target, "Jaw"), mask * weights[:, 2], atol=0.06)
    np.testing.assert_allclose(sum(weight_array(target, name) for name in ("Lower", "Head", "Jaw")), 1, atol=1e-5)
    assert snapshot(source) == before
    set_pose(armature, {"Jaw": (1.0, 0, 0)})
    moved = np.linalg.norm(visible_positions(target) - stood, axis=1)
    assert moved[weights[:, 2] == 0].max() < 1e-5
    assert moved[weights[:, 2] == 1].min() > 0.2


def test_bones_that_were_added_earlier_are_replaced():
    source, _ = head_source()
    target, armature, _ = rigged_target()
    found = []
    for _ in range(2):
        api.add_bones(bpy.context, source, target, "Head")
        found.append(weight_array(target, "Jaw"))
    assert armature.data.bones.keys() == ["Lower", "Head", "Jaw"]
    np.testing.assert_allclose(found[1], found[0], atol=0.06)


def test_bones_are_refused_in_a_sentence_and_nothing_changes():
    source, of_source = head_source()
    target, armature, _ = rigged_target()
    of_source.data.bones["Jaw"].name = "Lower 2"
    of_source.data.bones["Lower"].name = "Root"
    of_source.data.bones["Lower 2"].name = "Lower"
    before = snapshot(target)
    with pytest.raises(zo.MeshError, match="has another bone 'Lower', which does not move the part"):
        api.add_bones(bpy.context, source, target, "Head")
    with pytest.raises(zo.MeshError, match="has no vertex group 'Face' to use as a mask"):
        api.add_bones(bpy.context, source, target, "Face")
    assert snapshot(target) == before
    assert armature.data.bones.keys() == ["Lower", "Head"]
    target.modifiers["Skeleton"].object = of_source
    with pytest.raises(zo.MeshError, match="have the same armature"):
        api.add_bones(bpy.context, source, target, "Head")
    target.modifiers.clear()
    target.parent = None
    with pytest.raises(zo.MeshError, match="'Target' is bound to 0 armatures instead of one"):
        api.add_bones(bpy.context, source, target, "Head")


def test_weights_are_restored_if_bones_cannot_be_added(monkeypatch):
    source, _ = head_source()
    target, armature, _ = rigged_target()
    before = snapshot(target)

    def fail(*_):
        raise zo.MeshError("Stopped.")

    monkeypatch.setattr(part.mesh_data, "add_outfit_bones", fail)
    with pytest.raises(zo.MeshError, match="Stopped"):
        api.add_bones(bpy.context, source, target, "Head")
    assert snapshot(target) == before
    assert armature.data.bones.keys() == ["Lower", "Head"]


def test_the_button_adds_bones_to_a_masked_part_of_a_rigged_mesh():
    source, _ = head_source()
    target, armature, _ = rigged_target()
    activate(target)
    bpy.context.scene.zoomout.source = source
    assert bpy.ops.zoomout.move_rig(mask_group="Head") == {"FINISHED"}
    assert armature.data.bones.keys() == ["Lower", "Head", "Jaw"]
    assert target.find_armature() == armature
    with pytest.raises(RuntimeError, match="no vertex group 'Face' to use as a mask"):
        bpy.ops.zoomout.move_rig(mask_group="Face")
