# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys that bones drive act on another body by its own armature, and move its clothes."""

from functools import partial
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bent_tube import weights_of
from rigged import BONES, set_pose, visible_positions
from rigged import pose_target as fine_pose_target
from rigged import rig as make_rig
from rigged import source_and_rig as fine_source_and_rig
from scenes import key_shape, set_weights
from test_dress_objects import sleeve
from true_match import keep_true_match

from blender_addon import api
from blender_addon.adapters import Remarks
from blender_addon.adapters.key_drivers import read_key_drivers

source_and_rig = partial(fine_source_and_rig, around=10, along=31)
pose_target = partial(fine_pose_target, around=9, along=27)
BENT = {"Middle": (1.0, 0.0, 0.0)}
# Names of the bones of a target's own armature.
OTHERS = {"Lower": "Hip", "Middle": 'Knee "left"', "Upper": "Foot"}


def bulge(points):
    """(n, 3) offsets around the lower joint of the tube."""
    return 0.4 * np.exp(-2 * (points[:, 2:] - 2) ** 2) * points * [1, 1, 0]


def drive(obj, name, kind, block, **options):
    """Add a key that a variable drives, whose ends are a data-block and its properties; returns its driver."""
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name=name, from_mix=False)
    still = key_shape(obj.data, "Basis")
    key.points.foreach_set("co", (still + bulge(still)).astype(np.float32).ravel())
    key.value = 0
    curve = key.driver_add("value")
    curve.driver.type = "SUM"
    variable = curve.driver.variables.new()
    variable.type = kind
    for number, end in enumerate(variable.targets):
        if kind == "SINGLE_PROP":
            end.id_type = "KEY" if isinstance(block, bpy.types.Key) else "OBJECT"
        end.id = block
        for option, value in options.items():
            setattr(end, option, value[number] if isinstance(value, tuple) else value)
    return curve


def drive_by_turning(obj, armature):
    """Add a key that is on when the middle bone is bent by a radian."""
    return drive(
        obj,
        "Turned",
        "TRANSFORMS",
        armature,
        bone_target="Middle",
        transform_type="ROT_X",
        transform_space="LOCAL_SPACE",
    )


def own_rig(target, names=OTHERS):
    """Bind a target to its own armature at the same place, whose bones have other names."""
    armature = make_rig("Own", tuple(names[bone] for bone in BONES))
    target.modifiers.new("Armature", "ARMATURE").object = armature
    bpy.context.view_layer.update()
    return armature


def add_slider(armature, value):
    armature["slider"] = value
    armature.update_tag()  # or Blender evaluates it without the property


def transfer(source, target, **options):
    return api.transfer_objects(bpy.context, source, target, ["shape_keys"], **options)


def drivers_of(obj):
    return {curve.data_path.split('"')[1]: curve for curve in obj.data.shape_keys.animation_data.drivers}


def value_of(obj, name):
    bpy.context.view_layer.update()
    return obj.data.shape_keys.key_blocks[name].value


def ends_of(obj, name):
    return [end for variable in drivers_of(obj)[name].driver.variables for end in variable.targets]


def test_drivers_of_all_types_read_the_targets_own_armature():
    source, armature = source_and_rig()
    add_slider(armature, 0.0)
    drive_by_turning(source, armature).keyframe_points[1].co = (1, 0.5)
    drive(source, "Between", "ROTATION_DIFF", armature, bone_target=("Lower", "Middle")).modifiers.new("LIMITS")
    drive(source, "Apart", "LOC_DIFF", armature, bone_target=("Lower", "Upper")).driver.expression = "var"
    drive(source, "Euler", "SINGLE_PROP", armature, data_path='pose.bones["Middle"].rotation_euler[0]').mute = True
    drive(source, "Slid", "SINGLE_PROP", armature, data_path='["slider"]')
    keys = source.data.shape_keys
    drive(source, "Sum", "SINGLE_PROP", keys, data_path='key_blocks["Turned"].value').driver.type = "SCRIPTED"
    target, _ = pose_target(source, armature, {})
    own = own_rig(target)
    add_slider(own, 0.3)
    report = transfer(source, target)
    assert report["notes"] == []
    ends = {name: ends_of(target, name) for name in keys.key_blocks.keys()[1:]}
    assert {end.id for name in ends for end in ends[name]} == {own, target.data.shape_keys}
    assert [end.bone_target for end in ends["Between"]] == [OTHERS["Lower"], OTHERS["Middle"]]
    assert [end.bone_target for end in ends["Apart"]] == [OTHERS["Lower"], OTHERS["Upper"]]
    assert ends["Euler"][0].data_path == r'pose.bones["Knee \"left\""].rotation_euler[0]'
    made = drivers_of(target)
    assert [name for name, curve in made.items() if curve.mute] == ["Euler"]
    assert [modifier.type for modifier in made["Between"].modifiers] == ["LIMITS"]
    set_pose(armature, BENT)
    assert value_of(target, "Turned") == 0
    set_pose(own, {OTHERS["Middle"]: (1.0, 0, 0)})
    for name in ("Turned", "Between", "Apart", "Sum", "Slid"):
        wanted = 0.3 if name == "Slid" else value_of(source, name)
        assert value_of(target, name) == pytest.approx(wanted, abs=1e-3), name
    assert value_of(target, "Turned") == pytest.approx(0.5, abs=1e-3)


def test_keys_with_missing_bones_are_named_and_disabled():
    source, armature = source_and_rig()
    drive_by_turning(source, armature)
    drive(source, "Slid", "SINGLE_PROP", armature, data_path='["slider"]')
    drive(source, "Empty", "TRANSFORMS", bpy.data.objects.new("Control", None), transform_type="LOC_X")
    second = make_rig("Second", BONES)
    source.modifiers.new("Second", "ARMATURE").object = second
    drive(source, "Other", "TRANSFORMS", second, bone_target="Lower", transform_type="LOC_X")
    add_slider(armature, 0.7)
    target, _ = pose_target(source, armature, {})
    own_rig(target, {"Lower": "Lower", "Middle": "Gone", "Upper": "Upper"}).data.bones["Gone"].name = "Elsewhere"
    bpy.context.view_layer.objects.active = bpy.data.objects["Own"]
    bpy.ops.object.mode_set(mode="EDIT")
    edited = bpy.data.objects["Own"].data.edit_bones
    edited["Elsewhere"].head, edited["Elsewhere"].tail = (3, 0, 0), (3, 0, 2)
    edited["Elsewhere"].parent = edited["Upper"].parent = None
    bpy.ops.object.mode_set(mode="OBJECT")
    keep_true_match(target)
    notes = transfer(source, target)["notes"]
    assert list(drivers_of(target)) == ["Empty", "Other"]
    assert value_of(target, "Slid") == 0
    assert notes == [
        "Shape keys without their drivers (Turned, Slid): 'Target' and its armature lack what these read "
        '(Middle, ["slider"]).',
        "Drivers of shape keys still read other objects: 'Control', 'Second'.",
    ]


def test_bones_read_by_any_sources_drivers_are_paired():
    source, armature = source_and_rig()
    second = source.copy()
    second.data = source.data.copy()
    second.name = "Second"
    drive_by_turning(source, armature)
    drive(second, "Bent", "TRANSFORMS", armature, bone_target="Upper", transform_type="ROT_X")
    target, _ = pose_target(source, armature, {})
    own = own_rig(target, OTHERS | {"Middle": "Middle"})
    request = SimpleNamespace(target=target, sources=[SimpleNamespace(original=each) for each in (source, second)])
    found = read_key_drivers(request, [("Source", ["Turned"]), ("Second", ["Bent"])], Remarks())
    assert {names: rigs.read for names, rigs in found.rigs.items()} == {(armature.name, own.name): {"Middle", "Upper"}}


def test_bones_with_other_axes_are_noted():
    source, armature = source_and_rig()
    drive_by_turning(source, armature)
    target, _ = pose_target(source, armature, {})
    own = own_rig(target, {bone: bone for bone in BONES})
    bpy.context.view_layer.objects.active = own
    bpy.ops.object.mode_set(mode="EDIT")
    own.data.edit_bones["Middle"].roll = 1.0
    bpy.ops.object.mode_set(mode="OBJECT")
    (note,) = transfer(source, target)["notes"]
    assert note.startswith("At rest, bones of 'Own'")
    assert "(Middle)" in note


@pytest.mark.parametrize("first", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_moved_rig_drives_the_keys_of_its_body(first):
    source, armature = source_and_rig()
    drive_by_turning(source, armature)
    target, _ = pose_target(source, armature, {})
    if first:
        transfer(source, target)
        assert ends_of(target, "Turned")[0].id == armature
        own = own_rig(target, {bone: bone for bone in BONES})
        drive(target, "Own", "ROTATION_DIFF", own, bone_target=("Lower", "Middle"))
        report = api.move_rig(bpy.context, source, target, api.Binding(replace=True))
        assert ends_of(target, "Own")[0].id.name == report["bound"]["armature"]
    else:
        report = transfer(source, target, binding=api.Binding(move_rig=True))
    made = bpy.data.objects[report["bound"]["armature"]]
    assert ends_of(target, "Turned")[0].id == made
    assert ends_of(source, "Turned")[0].id == armature
    set_pose(made, BENT)
    assert (value_of(source, "Turned"), value_of(target, "Turned")) == (0, pytest.approx(1.0))


def test_correctives_of_the_body_and_of_clothes_move_the_clothes():
    source, armature = source_and_rig()
    drive_by_turning(source, armature)
    cloth = sleeve(armature)
    drive(
        cloth,
        "Fold",
        "TRANSFORMS",
        armature,
        bone_target="Upper",
        transform_type="ROT_X",
        transform_space="LOCAL_SPACE",
    )
    add_slider(armature, 0.7)
    drive(cloth, "Loose", "SINGLE_PROP", armature, data_path='["slider"]')
    assert value_of(cloth, "Loose") == pytest.approx(0.7)
    target, _ = pose_target(source, armature, {})
    own = own_rig(target, {bone: bone for bone in BONES})
    for each in (armature, own):
        each.data.bones["Upper"].use_deform = False
    transfer(source, target)
    report = api.dress(bpy.context, source, target, [cloth])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    (note,) = (note for note in report["notes"] if "drivers" in note.lower())
    assert note.startswith("Shape keys without their drivers (Loose)")
    assert value_of(copy, "Loose") == 0
    set_pose(own, {"Middle": (1.0, 0, 0), "Upper": (0.5, 0, 0)})
    assert value_of(copy, "Turned") == pytest.approx(1.0)
    assert value_of(copy, "Fold") == pytest.approx(0.5)
    corrected = visible_positions(copy)
    drivers_of(target)["Turned"].mute = True
    target.data.shape_keys.key_blocks["Turned"].value = 0
    moved = np.linalg.norm(corrected - visible_positions(copy), axis=1)
    assert 0.2 < moved.max() < 0.8


@pytest.mark.parametrize("has_own_rig", [True, False])
def test_correctives_do_not_move_cloth_that_the_skin_leaves(has_own_rig):
    source, armature = source_and_rig()
    drive_by_turning(source, armature)
    cloth = sleeve(armature)
    # Like a skirt: all of it is bound to the bone above the joint, and the skin below the upper half leaves it.
    cloth.vertex_groups.clear()
    set_weights(cloth, "Lower", np.ones(len(cloth.data.vertices)))
    target, _ = pose_target(source, armature, {})
    own = own_rig(target, {bone: bone for bone in BONES}) if has_own_rig else armature
    for name, column in zip(BONES, weights_of(visible_positions(target)).toarray().T, strict=True):
        set_weights(target, name, column)
    transfer(source, target, binding=None if has_own_rig else api.Binding())
    report = api.dress(bpy.context, source, target, [cloth])
    copy = bpy.data.objects[report["objects"]["Sleeve"]]
    moved = np.linalg.norm(key_shape(copy.data, "Turned") - key_shape(copy.data, "Basis"), axis=1)
    height = visible_positions(copy)[:, 2]
    set_pose(own, BENT)
    assert value_of(copy, "Turned") == pytest.approx(1.0)
    assert moved[height < 1.7].max() > 0.1
    assert moved[height > 2.55].max() < 0.03  # the skin below moves by 0.2
