# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys of a dressed target drive keys of its clothes."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from rigged import pose_target, set_pose, source_and_rig, visible_positions
from scenes import activate, key_shape, positions, set_weights, snapshot
from test_correctives import drive
from test_dress_objects import side, sleeve
from true_match import keep_true_match

from blender_addon import api


def add_key(obj, name, offsets, value=0.0):
    """Add a key that displaces the vertices by offsets (n, 3), in world space."""
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis")
    block = obj.shape_key_add(name=name, from_mix=False)
    own = offsets @ np.linalg.inv(np.array(obj.matrix_world)[:3, :3]).T
    block.points.foreach_set("co", (positions(obj.data) + own).astype(np.float32).ravel())
    block.slider_max, block.value = 2, value
    bpy.context.view_layer.update()
    return block


def widening(obj, amount=0.4):
    """(n, 3) offsets away from the tube's axis, around its middle."""
    points = visible_positions(obj)
    return amount * points * [1, 1, 0] * np.exp(-((points[:, 2:] - 3) ** 2))


def dressed(matrix=None, value=0.0, dressing=None):
    """A source, and a target with keys that was dressed in its sleeve; returns both and the copy."""
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, at_rest = pose_target(body, armature, {}, matrix=matrix)
    tip = np.where(visible_positions(target)[:, 2:] > 5.9, [0, 0, 0.2], 0)
    add_key(target, "Wide", widening(target), value)
    add_key(target, "Tip", tip)
    keep_true_match(target, at_rest)
    report = api.dress(bpy.context, body, target, [cloth], dressing)
    return body, target, bpy.data.objects[report["objects"]["Sleeve"]]


def test_keys_of_the_body_drive_keys_of_the_clothes():
    _, target, copy = dressed()
    keys = copy.data.shape_keys.key_blocks
    assert keys.keys() == ["Basis", "Wide"]  # the tip does not move the sleeve
    assert (keys["Wide"].slider_max, keys["Wide"].value) == (2, 0)
    before, apart = visible_positions(copy), side(visible_positions(copy), target)
    for value in (1.0, 0.5):
        target.data.shape_keys.key_blocks["Wide"].value = value
        bpy.context.view_layer.update()
        assert np.linalg.norm(visible_positions(copy) - before, axis=1).max() > 0.2 * value
        off = side(visible_positions(copy), target)
        assert off.min() > 0
        assert np.abs(off - apart).mean() < 0.03
    target.data.shape_keys.key_blocks["Wide"].value = 0
    bpy.context.view_layer.update()
    np.testing.assert_allclose(visible_positions(copy), before, atol=1e-5)


def test_the_clothes_fit_at_the_present_value_of_a_key():
    _, target, copy = dressed(value=0.5)
    assert copy.data.shape_keys.key_blocks["Wide"].value == pytest.approx(0.5)
    worn = side(visible_positions(copy), target)
    assert worn.min() > 0
    target.data.shape_keys.key_blocks["Wide"].value = 0
    bpy.context.view_layer.update()
    off = side(visible_positions(copy), target)
    assert off.min() > 0
    assert np.abs(off - worn).mean() < 0.03


@pytest.mark.slow
def test_a_target_with_any_matrix_gives_the_same_keys():
    _, _, copy = dressed()
    offsets = key_shape(copy.data, "Wide") - key_shape(copy.data, "Basis")
    world = offsets @ np.array(copy.matrix_world)[:3, :3].T
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _, _, copy = dressed(Matrix.LocRotScale((1, 2, 3), None, (2, 2, 2)) @ Matrix.Rotation(0.5, 4, "X"))
    offsets = key_shape(copy.data, "Wide") - key_shape(copy.data, "Basis")
    np.testing.assert_allclose(offsets @ np.array(copy.matrix_world)[:3, :3].T, world, atol=1e-3)


def test_keys_of_a_bound_target_act_before_the_bones():
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, _ = pose_target(body, armature, {})
    api.bind_to_rig(bpy.context, body, target)
    add_key(target, "Wide", widening(target))
    set_pose(armature, {"Middle": (0.4, 0, 0)})
    report = api.dress(bpy.context, body, target, [cloth])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    target.data.shape_keys.key_blocks["Wide"].value = 1
    bpy.context.view_layer.update()
    assert (side(visible_positions(copy), target) < 0).mean() < 0.02
    target.data.shape_keys.key_blocks["Wide"].value = 0
    bpy.context.view_layer.update()
    assert (side(visible_positions(copy), target) < 0).mean() < 0.02


def test_key_masks_of_the_body_apply_to_clothes():
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, _ = pose_target(body, armature, {})
    set_weights(target, "Front", (positions(target.data)[:, 1] < 0).astype(float))
    add_key(target, "Wide", widening(target)).vertex_group = "Front"
    report = api.dress(bpy.context, body, target, [cloth])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    moved = np.linalg.norm(key_shape(copy.data, "Wide") - key_shape(copy.data, "Basis"), axis=1)
    behind = positions(copy.data)[:, 1] > 0.3
    assert moved.max() > 0.2
    assert moved[behind].max() < 0.05
    assert not copy.data.shape_keys.key_blocks["Wide"].vertex_group


@pytest.mark.slow
def test_keys_are_optional_and_replaced_with_the_copy():
    body, target, copy = dressed(dressing=api.Dressing(follow_keys=False))
    assert copy.data.shape_keys is None
    before = snapshot(target)
    cloth = bpy.data.objects["Sleeve"]
    for _ in range(2):
        report = api.dress(bpy.context, body, target, [cloth])
        keys = bpy.data.objects[report["objects"]["Sleeve"]].data.shape_keys
        assert keys.key_blocks.keys() == ["Basis", "Wide"]
        assert [curve.data_path for curve in keys.animation_data.drivers] == ['key_blocks["Wide"].value']
    assert snapshot(target) == before


def test_clothes_without_keys_fit_the_present_values():
    """Except those of correctives, which are zero at rest."""
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, _ = pose_target(body, armature, {})
    api.bind_to_rig(bpy.context, body, target)
    add_key(target, "Wide", widening(target), value=1.0)
    drive(target, "Corrective", "ROTATION_DIFF", armature, bone_target=("Lower", "Middle"))
    far = positions(target.data) + np.array([5, 0, 0], np.float32)
    target.data.shape_keys.key_blocks["Corrective"].points.foreach_set("co", far.ravel())
    set_pose(armature, {"Middle": (0.4, 0, 0)})
    report = api.dress(bpy.context, body, target, [cloth], api.Dressing(follow_keys=False))
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    assert copy.data.shape_keys is None
    set_pose(armature, {})
    assert target.data.shape_keys.key_blocks["Corrective"].value == pytest.approx(0, abs=0.01)
    off = side(visible_positions(copy), target)
    assert off.min() > 0
    assert off.mean() < 0.3


@pytest.mark.parametrize("has_it", [True, False])
def test_keys_that_hide_skin_below_clothes_are_proposed(has_it):
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, at_rest = pose_target(body, armature, {})
    add_key(body, "Thin below", widening(body, -0.2), value=1.0)
    add_key(body, "Thin, not in use", widening(body, -0.2))
    add_key(body, "Wide", widening(body, 0.01), value=1.0)
    if has_it:
        add_key(target, "Thin below", widening(target, -0.2))
    keep_true_match(target, at_rest)
    (note,) = [note for note in api.dress(bpy.context, body, target, [cloth])["notes"] if "hide skin" in note]
    assert "objects: Thin below. " in note
    assert ("has them, too" in note) == has_it
    assert ("Transfer them" in note) != has_it


def test_a_deformed_target_gets_a_note():
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, _ = pose_target(body, armature, {})
    add_key(target, "Wide", widening(target))
    wave = target.modifiers.new("Wave", "SIMPLE_DEFORM")
    wave.deform_method, wave.angle, wave.deform_axis = "TWIST", 0.2, "Z"
    bpy.context.view_layer.update()
    report = api.dress(bpy.context, body, target, [cloth])
    assert any("no keys for the shape keys of 'Target'" in note for note in report["notes"])
    assert bpy.data.objects[report["objects"]["Sleeve"]].data.shape_keys is None


@pytest.mark.parametrize("follow", [True, False])
def test_operator_option_controls_following_keys(follow):
    body, armature = source_and_rig()
    cloth = sleeve(armature)
    target, _ = pose_target(body, armature, {})
    add_key(target, "Wide", widening(target))
    activate(target, cloth, body)
    assert bpy.ops.zoomout.dress(dress_follow_keys=follow) == {"FINISHED"}
    (copy,) = bpy.data.collections["Target Dress"].objects
    assert (copy.data.shape_keys is not None) == follow
