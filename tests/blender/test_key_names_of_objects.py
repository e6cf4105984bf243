# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys are renamed with all that refers to them."""

import bpy
import numpy as np
import pytest
from scenes import activate, ellipsoid, positions, set_weights, snapshot_file

import zoomout_core as zo
from blender_addon.mesh_data import rename_shape_keys as rename_blocks
from blender_addon.services.key_names import rename_shape_keys


@pytest.fixture
def face(empty_scene):
    """An object with expression keys in ARKit's spelling with underscores, two of them masked, and one of its own."""
    obj = ellipsoid("Face", 3)
    points = positions(obj.data)
    obj.shape_key_add(name="Basis", from_mix=False)
    for number, name in enumerate(("browInnerUp_L", "browInnerUp_R", "jawOpen", "eyeBlink_L", "Ears")):
        block = obj.shape_key_add(name=name, from_mix=False)
        block.points.foreach_set("co", (points + (number + 1) * np.array([0.0, 0.0, 0.01])).ravel())
    left = (points[:, 0] > 0).astype(float)
    for side, mask in (("L", left), ("R", 1 - left)):
        set_weights(obj, f"Side {side}", mask)
        obj.data.shape_keys.key_blocks[f"browInnerUp_{side}"].vertex_group = f"Side {side}"
    activate(obj)
    return obj


def names(obj):
    return obj.data.shape_keys.key_blocks.keys()


def shape(obj, name):
    block = obj.data.shape_keys.key_blocks[name]
    points = np.empty(3 * len(block.points), np.float32)
    block.points.foreach_get("co", points)
    return points.reshape(-1, 3)


def curves(action):
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    return [
        curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves
    ]


def test_keys_are_renamed_and_sums_added(face):
    said = rename_shape_keys(bpy.context, face, "arkit")
    assert names(face) == [
        *("Basis", "browInnerUp_L", "browInnerUp_R", "jawOpen", "eyeBlinkLeft", "Ears"),
        "browInnerUp",
    ]
    assert said.startswith("Renamed 1 shape key to the spelling of ARKit. Added sums of shape keys: browInnerUp = ")
    # Each half of the sum is that of its own side, as the masks show it.
    offset = (shape(face, "browInnerUp") - positions(face.data))[:, 2]
    left = positions(face.data)[:, 0] > 0
    np.testing.assert_allclose(offset, np.where(left, 0.01, 0.02), atol=1e-6)
    assert face.data.shape_keys.key_blocks["browInnerUp"].value == 0


def test_without_sums_keys_are_only_renamed(face):
    said = rename_shape_keys(bpy.context, face, "unified", compose=False)
    assert names(face) == ["Basis", "BrowInnerUpLeft", "BrowInnerUpRight", "JawOpen", "EyeClosedLeft", "Ears"]
    assert said.startswith("Renamed 4 shape keys from ARKit to Unified Expressions. Missing of the 116 keys")


def test_animations_and_drivers_follow(face):
    key, other = face.data.shape_keys, ellipsoid("Other", 2)
    jaw = key.key_blocks["jawOpen"]
    jaw.keyframe_insert("value", frame=1)
    own = key.key_blocks["Ears"].driver_add("value").driver.variables.new()
    away = other.driver_add("location", 0).driver.variables.new()
    for variable in (own, away):
        variable.targets[0].id_type, variable.targets[0].id = "KEY", key
        variable.targets[0].data_path = 'key_blocks["jawOpen"].value'
    rename_shape_keys(bpy.context, face, "unified")
    assert [curve.data_path for curve in curves(key.animation_data.action)] == ['key_blocks["JawOpen"].value']
    assert {variable.targets[0].data_path for variable in (own, away)} == {'key_blocks["JawOpen"].value'}
    assert [curve.data_path for curve in key.animation_data.drivers] == ['key_blocks["Ears"].value']


def test_names_may_be_exchanged(face):
    before = {name: shape(face, name) for name in ("jawOpen", "Ears")}
    rename_blocks(face.data.shape_keys, {"jawOpen": "Ears", "Ears": "jawOpen"})
    np.testing.assert_array_equal(shape(face, "Ears"), before["jawOpen"])
    np.testing.assert_array_equal(shape(face, "jawOpen"), before["Ears"])


def test_no_key_takes_the_name_of_the_basis(face):
    face.data.shape_keys.reference_key.name = "JawOpen"
    rename_shape_keys(bpy.context, face, "unified")
    assert names(face)[:4] == ["JawOpen", "BrowInnerUpLeft", "BrowInnerUpRight", "jawOpen"]


def test_the_operator_renames_the_active_mesh(face):
    assert bpy.ops.zoomout.rename_shape_keys(convention="VRM1") == {"FINISHED"}
    assert "blinkLeft" in names(face)
    assert "blink" not in names(face)  # there is only one side


def test_renaming_is_one_undo_step(face):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="Before")
    before = names(face)
    assert bpy.ops.zoomout.rename_shape_keys(convention="UNIFIED") == {"FINISHED"}
    bpy.ops.ed.undo_push(message="Renamed")  # Blender does so after an operator in a window
    bpy.ops.ed.undo()
    assert bpy.data.objects["Face"].data.shape_keys.key_blocks.keys() == before
    bpy.ops.ed.redo()
    assert "BrowInnerUpLeft" in bpy.data.objects["Face"].data.shape_keys.key_blocks


def test_names_of_no_convention_are_kept(face):
    for number, block in enumerate(face.data.shape_keys.key_blocks[1:]):
        block.name = f"Morph {number}"
    before = snapshot_file()
    assert "follow no known convention" in rename_shape_keys(bpy.context, face, "arkit")
    assert snapshot_file() == before


def test_a_mesh_without_shape_keys_is_refused(empty_scene):
    obj = ellipsoid("Plain", 2)
    activate(obj)
    with pytest.raises(zo.MeshError, match="'Plain' has no shape keys: add or transfer some first"):
        rename_shape_keys(bpy.context, obj, "arkit")
    with pytest.raises(RuntimeError, match="has no shape keys"):
        bpy.ops.zoomout.rename_shape_keys()


def test_shape_key_menu_contains_the_operator():
    assert bpy.types.MESH_MT_shape_key_context_menu.is_extended()
