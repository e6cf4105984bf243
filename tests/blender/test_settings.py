# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of a transfer: filling in, blending with existing data, limits, renaming, and clothes on a body."""

import math

import bpy
import numpy as np
import pytest
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    ellipsoid,
    from_pydata,
    key_shape,
    new_material,
    positions,
    set_weights,
    snapshot_file,
    values,
    weight_array,
    weights,
)

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.adapters import Settings, parse_group_names, parse_names
from blender_addon.scene.pair import read_pair
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from blender_addon.storage.stored_report import transfer_report


@pytest.fixture
def source():
    return ellipsoid("Source")


@pytest.fixture
def target(source):
    """A copy of the mesh; its match is true, except around one end, where it is wrong and has low confidence."""
    obj = ellipsoid("Target")
    keep_match(obj)
    return obj


def keep_match(target):
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    vertex = np.arange(len(pair.target.vertices))
    vertex[doubtful(target)] = 0
    confidence = np.where(doubtful(target), 0.01, 0.9)
    match = stored_match.StoredMatch(zo.SurfaceMap.from_vertices(vertex, pair.source), confidence, ())
    stored_match.write(target.data, match, pair, {})


def doubtful(obj):
    """(n,) which vertices are matched wrongly."""
    return positions(obj.data)[:, 0] > 0.8


def ramp(obj, axis=1):
    """(n,) from 0 to 1 along an axis."""
    coordinate = positions(obj.data)[:, axis]
    return (coordinate - coordinate.min()) / np.ptp(coordinate)


def skin(source):
    """Vertex groups of two bones, both with a weight at every vertex."""
    set_weights(source, "Arm.L", 1 - ramp(source))
    set_weights(source, "Arm.R", ramp(source))


def transfer(source, target, *data, **settings):
    return transfer_objects(bpy.context, source, target, data, Settings(**settings))


def test_low_confidence_values_are_filled_in_and_reported(source, target):
    skin(source)
    add_attribute(source.data, "Paint", "FLOAT_COLOR", "POINT", np.repeat(ramp(source)[:, None], 4, axis=1))
    add_attribute(source.data, "side", "FLOAT", "POINT", ramp(source))
    there = doubtful(target)
    everything = "vertex_groups", "color_attributes", "attributes"
    plain = transfer(source, target, *everything, fill_below=0)
    assert not any("usable match" in note for note in plain["notes"])
    wrong = np.abs(weight_array(target, "Arm.R") - ramp(target))[there].mean()
    report = transfer(source, target, *everything)
    for found in (weight_array(target, "Arm.R"), values(target.data, "Paint")[:, 0], values(target.data, "side")):
        assert np.abs(found - ramp(target))[there].mean() < 0.3 * wrong
        np.testing.assert_allclose(found[~there], ramp(target)[~there], atol=1e-4)
    np.testing.assert_allclose(weight_array(target, "Arm.L") + weight_array(target, "Arm.R"), 1, atol=1e-6)
    assert [note for note in report["notes"] if "usable match" in note] == [
        f"{there.sum():,} vertices without a usable match took their neighbors' values."
    ]


def test_transfer_blends_with_existing_data_by_factor_and_mask(source, target):
    skin(source)
    add_attribute(source.data, "Paint", "FLOAT_COLOR", "POINT", np.ones((len(source.data.vertices), 4)))
    add_attribute(source.data, "zone", "INT", "POINT", np.full(len(source.data.vertices), 7))
    add_uv_map(source.data, "Map")
    count = len(target.data.vertices)
    mask = ramp(target, axis=2)
    set_weights(target, "Mask", mask)
    set_weights(target, "Arm.L", np.full(count, 0.75))
    set_weights(target, "Arm.R", np.full(count, 0.25))
    add_attribute(target.data, "Paint", "FLOAT_COLOR", "POINT", np.full((count, 4), 0.5))
    add_attribute(target.data, "zone", "INT", "POINT", np.full(count, 3))
    before = weights(target)["Mask"]
    everything = "vertex_groups", "color_attributes", "attributes", "uv_maps"
    transfer(source, target, *everything, mask_group="Mask", factor=0.8)
    kept = ~doubtful(target)
    expected = 0.25 + 0.8 * mask * (ramp(target) - 0.25)
    np.testing.assert_allclose(weight_array(target, "Arm.R")[kept], expected[kept], atol=1e-4)
    np.testing.assert_allclose(weight_array(target, "Arm.L") + weight_array(target, "Arm.R"), 1, atol=1e-5)
    assert weights(target)["Mask"] == before
    np.testing.assert_allclose(values(target.data, "Paint")[:, 0], 0.5 + 0.4 * mask, atol=1e-5)
    np.testing.assert_array_equal(values(target.data, "zone"), np.where(0.8 * mask > 0.5, 7, 3))
    corner = values(target.data, "Map").reshape(-1, 3, 2)
    of_face = mask[np.array([list(face.vertices) for face in target.data.polygons])].mean(axis=1) * 0.8 > 0.5
    np.testing.assert_array_equal((corner != 0).any(axis=(1, 2)), of_face)


def test_a_second_source_in_a_mask_keeps_the_materials_and_keys_of_the_first(source, target):
    count, mask = len(target.data.vertices), ramp(target, axis=2)
    for obj, material, key in ((source, "Head", "Blink"), (target, "Body", "Lean")):
        obj.data.materials.append(new_material(material))
        at = positions(obj.data)
        for name, height in (("Basis", 0), ("Smile", 0.2 if obj == source else 0.1), (key, 0.3)):
            points = (at + np.array([0, 0, height])).astype(np.float32)
            obj.shape_key_add(name=name, from_mix=False).points.foreach_set("co", points.ravel())
    set_weights(target, "Mask", mask)
    transfer(source, target, "materials", "shape_keys", mask_group="Mask")
    of_face = mask[np.array([list(face.vertices) for face in target.data.polygons])].mean(axis=1) > 0.5
    names = [slot.name for slot in target.data.materials]
    assert [names[face.material_index] == "Head" for face in target.data.polygons] == of_face.tolist()
    assert set(names) == {"Head", "Body"}
    kept, rest = ~doubtful(target), positions(target.data)
    for name, offset in (("Smile", 0.1 + 0.1 * mask), ("Blink", 0.3 * mask), ("Lean", np.full(count, 0.3))):
        moved = key_shape(target.data, name) - rest
        np.testing.assert_allclose(moved[kept, 2], offset[kept], atol=0.03)


def test_groups_that_no_bone_of_the_target_moves_are_noted_in_a_mask(source, target):
    for obj, bones in ((source, ("Arm.L", "Arm.R")), (target, ("Arm.L", "Hand"))):
        armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
        bpy.context.collection.objects.link(armature)
        activate(armature)
        bpy.ops.object.mode_set(mode="EDIT")
        for name in bones:
            armature.data.edit_bones.new(name).tail = (0, 0, 1)
        bpy.ops.object.mode_set(mode="OBJECT")
        obj.modifiers.new("Rig", "ARMATURE").object = armature
    skin(source)
    set_weights(target, "Mask", ramp(target, axis=2))
    foreign = "no bones for 1 vertex groups, such as 'Arm.R'"
    report = transfer(source, target, "vertex_groups", mask_group="Mask")
    assert any(foreign in note for note in report["notes"])
    assert not any(foreign in note for note in transfer(source, target, "vertex_groups")["notes"])


def test_weights_are_added_only_where_there_are_none(source, target):
    skin(source)
    rigged = ramp(target, axis=2) > 0.5
    set_weights(target, "Arm.L", rigged.astype(float))
    transfer(source, target, "vertex_groups", mode="missing", fill_below=0)
    right = weight_array(target, "Arm.R")
    assert (right[rigged] == 0).all()
    assert (weight_array(target, "Arm.L")[rigged] == 1).all()
    bare = ~rigged & ~doubtful(target)
    np.testing.assert_allclose(right[bare], ramp(target)[bare], atol=1e-4)


def test_faces_outside_the_mask_keep_their_materials(source, target):
    red, green, blue = (new_material(name) for name in ("red", "green", "blue"))
    source.data.materials.append(red)
    for material in (green, blue):
        target.data.materials.append(material)
    target.data.polygons.foreach_set("material_index", np.full(len(target.data.polygons), 1, np.int32))
    set_weights(target, "Mask", (ramp(target) > 0.5).astype(float))
    transfer(source, target, "materials", mask_group="Mask")
    shown = np.array([target.data.materials[face.material_index].name for face in target.data.polygons])
    mask = weight_array(target, "Mask")
    inside = np.array([mask[list(face.vertices)].mean() for face in target.data.polygons]) > 0.5
    np.testing.assert_array_equal(shown, np.where(inside, "red", "blue"))


def test_materials_are_added_only_to_faces_without_any(source, target):
    source.data.materials.append(new_material("red"))
    for material in (None, new_material("blue")):
        target.data.materials.append(material)
    second = np.arange(len(target.data.polygons)) % 2
    target.data.polygons.foreach_set("material_index", second.astype(np.int32))
    transfer(source, target, "materials", mode="missing")
    shown = np.array([target.data.materials[face.material_index].name for face in target.data.polygons])
    np.testing.assert_array_equal(shown, np.where(second == 1, "blue", "red"))


def rig(*names):
    """An armature with a bone of each name."""
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(armature)
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    for name in names:
        armature.data.edit_bones.new(name).tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def test_flipped_and_renamed_groups_still_deform(source, target):
    armature = rig("Arm.L", "Arm.R", "Hip")
    source.modifiers.new("Armature", "ARMATURE").object = armature
    bpy.context.view_layer.update()
    keep_match(target)
    skin(source)
    set_weights(source, "Hip", np.zeros(len(source.data.vertices)))
    set_weights(source, "Mask", np.full(len(source.data.vertices), 0.4))
    transfer(source, target, "vertex_groups", flip_names=True, group_names={"Hip": "Pelvis"})
    assert [group.name for group in target.vertex_groups] == ["Arm.R", "Arm.L", "Pelvis", "Mask"]
    kept = ~doubtful(target)
    np.testing.assert_allclose(weight_array(target, "Arm.L")[kept], ramp(target)[kept], atol=1e-4)
    np.testing.assert_allclose(weight_array(target, "Arm.L") + weight_array(target, "Arm.R"), 1, atol=1e-6)
    np.testing.assert_allclose(weight_array(target, "Mask"), 0.4, atol=1e-5)


def test_infix_sides_flip_if_both_sides_exist(source, target):
    keep_match(target)
    for name in ("mixamorig:LeftArm", "mixamorig:RightArm", "mixamorig:LeftWing"):
        set_weights(source, name, ramp(source) if "Arm" in name else 1 - ramp(source))
    transfer(source, target, "vertex_groups", flip_names=True)
    assert target.vertex_groups.keys() == ["mixamorig:RightArm", "mixamorig:LeftArm", "mixamorig:LeftWing"]


def test_names_are_given_as_pairs():
    assert parse_names(" flow, spin ,") == ("flow", "spin")
    assert parse_group_names(" Arm = Upper Arm,Spine=Back , ") == {"Arm": "Upper Arm", "Spine": "Back"}
    for wrong in ("Arm", "Arm=", "=Arm", "Arm=Upper Arm, Spine"):
        with pytest.raises(zo.MeshError, match="old = new"):
            parse_group_names(wrong)


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_weight_limit_holds_after_blending(source, target, factor):
    names = [f"Bone {i}" for i in range(6)]
    for obj, centre in ((source, 0.0), (target, 0.2)):
        share = np.exp(-(((ramp(obj)[:, None] - centre - np.arange(6) / 5) / 0.3) ** 2))
        share /= share.sum(axis=1, keepdims=True)
        for name, column in zip(names, share.T, strict=True):
            set_weights(obj, name, column)
    transfer(source, target, "vertex_groups", limit=3, factor=factor)
    table = np.stack([weight_array(target, name) for name in names], axis=1)
    assert (table > 0).sum(axis=1).max() == 3
    np.testing.assert_allclose(table.sum(axis=1), 1, atol=1e-5)


def test_missing_mask_is_refused_before_writing(source, target):
    skin(source)
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="'Target' has no vertex group 'Mask'"):
        transfer(source, target, "vertex_groups", mask_group="Mask")
    assert snapshot_file() == before


def test_omitted_settings_come_from_the_scene(source, target):
    skin(source)
    activate(target, source)
    settings = bpy.context.scene.zoomout
    settings.factor, settings.group_names, settings.turning = 0.5, "Arm.L = Leg.L", "flow"
    assert bpy.ops.zoomout.transfer(flip_names=True) == {"FINISHED"}
    kept = ~doubtful(target)
    np.testing.assert_allclose(weight_array(target, "Leg.L")[kept], (1 - ramp(target))[kept] / 2, atol=1e-4)
    assert "Arm.L" in weights(target)  # the source's right arm
    assert any(note.startswith("flow: not rotated") for note in transfer_report(target)["notes"])
    with pytest.raises(RuntimeError, match="old = new"):
        bpy.ops.zoomout.transfer(group_names="Arm.L")


def legs(name, radius):
    """Two upright tubes so close that each, slightly widened, is closer to the other's surface than to its own."""
    around, rows = 32, 16
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
    vertices, faces = [], []
    for x in (1.1, -1.1):
        first = len(vertices)
        for z in np.linspace(0, 4, rows):
            vertices += [(x + radius * math.cos(t), radius * math.sin(t), z) for t in turn]
        for i in range(rows - 1):
            row, after = first + i * around, first + (i + 1) * around
            faces += [(row + j, row + (j + 1) % around, after + (j + 1) % around, after + j) for j in range(around)]
    return from_pydata(name, vertices, faces)


def test_clothes_move_with_the_leg_that_they_are_on():
    body, cloth = legs("Body", 1.0), legs("Cloth", 1.17)
    armature = rig("Leg.L", "Leg.R")
    left = positions(body.data)[:, 0] > 0
    set_weights(body, "Leg.L", left.astype(float))
    set_weights(body, "Leg.R", (~left).astype(float))
    for obj in (body, cloth):
        obj.modifiers.new("Armature", "ARMATURE").object = armature
    bpy.context.view_layer.update()
    rest = positions(cloth.data)
    of_left = np.arange(len(rest)) < len(rest) // 2  # which is not always on the left: the tubes cut into each other

    def moved(**options):
        """The displacement of each vertex of the cloth when the left leg moves."""
        activate(cloth, body)
        assert bpy.ops.zoomout.match(initial="NEAREST", **options) == {"FINISHED"}
        assert bpy.ops.zoomout.transfer(initial="NEAREST", **options) == {"FINISHED"}
        armature.pose.bones["Leg.L"].location = (0, 0.5, 0)
        bpy.context.view_layer.update()
        posed = cloth.evaluated_get(bpy.context.evaluated_depsgraph_get())
        distance = np.linalg.norm(positions(posed.data) - rest, axis=1)
        armature.pose.bones["Leg.L"].location = (0, 0, 0)
        bpy.context.view_layer.update()
        return distance

    assert np.abs(moved(max_angle=math.pi) - 0.5 * of_left).max() > 0.4
    assert np.abs(moved() - 0.5 * of_left).max() < 1e-4
    notes = transfer_report(cloth)["notes"]
    assert any("faces another way" in note for note in notes)
    assert any("usable match" in note for note in notes)
    assert not any("existing match" in note for note in notes)
