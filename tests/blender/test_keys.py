# SPDX-License-Identifier: GPL-3.0-or-later
"""Transferred shape keys: their visible effect, drivers and animation."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from scenes import (
    activate,
    decimate,
    ellipsoid,
    from_pydata,
    key_shape,
    link,
    positions,
    set_weights,
    snapshot_file,
    visible_positions,
)

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from blender_addon.storage.stored_report import transfer_report
from zoomout_core.geometry.closest_points import closest_points


@pytest.fixture
def source():
    return ellipsoid("Source")


@pytest.fixture
def target(source):
    """The source's shape with fewer triangles, in the same place, and the true match with it."""
    obj = decimate()
    keep_match(obj, positions(obj.data))
    return obj


def keep_match(target, places):
    """Store the match of each vertex to the closest point of the source's own mesh to its place (n, 3)."""
    pair = jobs.run(read_pair(bpy.context, "Source", target.name))
    source = positions(bpy.data.objects["Source"].data).astype(float)
    if len(source) == len(pair.source.vertices):
        surface_map = zo.SurfaceMap(*closest_points(places, source, pair.source.triangles), pair.source.triangles)
    else:
        surface_map = zo.SurfaceMap(
            *closest_points(places, pair.source.vertices, pair.source.triangles), pair.source.triangles
        )
    match = stored_match.StoredMatch(surface_map, np.ones(len(places)), ())
    stored_match.write(target.data, match, pair, {})


def swelling(points):
    """(n, 3) displacements of points by a swelling at one end."""
    return 0.3 * np.clip(points[:, :1] - 0.2, 0, 1) * points


def sliding(points):
    return 0.4 * np.clip(points[:, :1] + 0.3, 0, 1) * np.array([0, 0.3, 1])


def add_key(obj, name, offsets):
    """Add a key with offsets (n, 3) from the Basis, which is added first if it is missing."""
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis", from_mix=False)
    key = obj.shape_key_add(name=name, from_mix=False)
    key.value = 0
    key.points.foreach_set("co", (key_shape(obj.data, "Basis") + offsets).astype(np.float32).ravel())
    return key


def add_keys(obj):
    points = positions(obj.data)
    add_key(obj, "Swell", swelling(points))
    add_key(obj, "Slide", sliding(points))


def blocks(obj):
    return obj.data.shape_keys.key_blocks


def played(obj, name, value=1.0):
    """(n, 3) visible displacements of vertices, in world space, by a single key."""
    keys = blocks(obj)
    before = {key.name: key.value for key in keys}
    for key in keys:
        key.value = 0
    still = visible_positions(obj)
    keys[name].value = value
    moved = visible_positions(obj) - still
    for key in keys:
        key.value = before[key.name]
    return moved


def error(offsets, truth):
    return np.sqrt(((offsets - truth) ** 2).sum() / (truth**2).sum())


def transfer(source, target, *data):
    return transfer_objects(bpy.context, source, target, data or ("shape_keys",))


def test_transferred_keys_move_target_like_source(source, target):
    add_keys(source)
    report = transfer(source, target)
    assert report["written"]["shape_keys"] == ["Swell", "Slide"]
    assert report["skipped"] == {}
    assert blocks(target).keys() == ["Basis", "Swell", "Slide"]
    points = positions(target.data)
    np.testing.assert_array_equal(key_shape(target.data, "Basis"), points)
    assert error(played(target, "Swell"), swelling(points)) < 0.03
    assert error(played(target, "Slide"), sliding(points)) < 0.03
    still = points[:, 0] < 0.1
    assert (key_shape(target.data, "Swell")[still] == points[still]).all()
    np.testing.assert_array_equal(visible_positions(target), points)


def test_keys_keep_their_settings(source, target):
    add_keys(source)
    set_weights(source, "Upper", np.ones(len(source.data.vertices)))
    set_weights(target, "Upper", np.ones(len(target.data.vertices)))
    swell, slide = blocks(source)["Swell"], blocks(source)["Slide"]
    swell.slider_min, swell.slider_max, swell.value = -2, 3, 2.5
    slide.slider_min, slide.slider_max, slide.value = -4, -2, -3
    slide.mute, slide.vertex_group, slide.interpolation, slide.lock_shape = True, "Upper", "KEY_CARDINAL", True
    report = transfer(source, target)
    assert not any("vertex groups" in note for note in report["notes"])
    swell, slide = blocks(target)["Swell"], blocks(target)["Slide"]
    assert (swell.slider_min, swell.slider_max, swell.value, swell.mute) == (-2, 3, 2.5, False)
    assert (slide.slider_min, slide.slider_max, slide.value) == (-4, -2, -3)
    assert (slide.mute, slide.vertex_group, slide.interpolation, slide.lock_shape) == (
        True,
        "Upper",
        "KEY_CARDINAL",
        True,
    )


def test_a_mask_that_the_target_lacks_is_noted(source, target):
    add_keys(source)
    set_weights(source, "Upper", np.ones(len(source.data.vertices)))
    blocks(source)["Slide"].vertex_group = "Upper"
    (note,) = [note for note in transfer(source, target)["notes"] if "vertex groups" in note]
    assert "(Upper)" in note
    assert not any(
        "Shape keys use vertex groups" in note
        for note in transfer(source, target, "shape_keys", "vertex_groups")["notes"]
    )


def test_relative_keys_stay_relative(source, target):
    add_keys(source)
    points = positions(source.data)
    key = add_key(source, "Then", swelling(points) + sliding(points))
    key.relative_key = blocks(source)["Swell"]
    first = add_key(source, "Round", sliding(points))
    second = add_key(source, "About", swelling(points))
    first.relative_key, second.relative_key = second, first
    transfer(source, target)
    assert [key.relative_key.name for key in blocks(target)] == ["Basis", "Basis", "Basis", "Swell", "About", "Round"]
    points = positions(target.data)
    assert error(played(target, "Then"), sliding(points)) < 0.03
    assert error(played(target, "Round"), sliding(points) - swelling(points)) < 0.05


def test_keys_of_the_same_name_are_overwritten_and_others_stay(source, target):
    add_keys(source)
    points = positions(target.data)
    own = add_key(target, "Own", sliding(points))
    own.value, own.slider_max = 0.75, 2
    add_key(target, "Slide", swelling(points)).value = 0.5
    target.active_shape_key_index = 1
    before = key_shape(target.data, "Own").tobytes()
    transfer(source, target)
    assert blocks(target).keys() == ["Basis", "Own", "Slide", "Swell"]
    assert key_shape(target.data, "Own").tobytes() == before
    assert (blocks(target)["Own"].value, blocks(target)["Own"].slider_max) == (0.75, 2)
    assert target.active_shape_key_index == 1
    assert error(played(target, "Slide"), sliding(points)) < 0.03
    assert blocks(target)["Slide"].value == 0
    transfer(source, target)
    assert blocks(target).keys() == ["Basis", "Own", "Slide", "Swell"]


@pytest.mark.parametrize("scale", [(2, 2, 2), (-1.5, 1.5, 1.5)])
def test_keys_are_transferred_in_the_objects_own_space(source, target, scale):
    add_keys(source)
    # The same thing is seen in the same place, by two objects with other transforms.
    turn = Matrix.LocRotScale((1, 2, 3), Matrix.Rotation(1.1, 3, (1, 2, 0.5)), scale)
    target.data.transform(turn.inverted())
    if turn.is_negative:
        target.data.flip_normals()
    target.matrix_world = turn
    bpy.context.view_layer.update()
    places = visible_positions(target)
    keep_match(target, places)
    transfer(source, target)
    assert error(played(target, "Swell"), swelling(places)) < 0.03
    assert error(played(target, "Slide"), sliding(places)) < 0.03


def bend(obj, armature, angle):
    bone = armature.pose.bones["Upper"]
    bone.rotation_mode = "XYZ"
    bone.rotation_euler = (0, 0, angle)
    bpy.context.view_layer.update()


def rigged(obj):
    """An armature of two bones along x that bends an object in the middle."""
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(armature)
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    for name, head, tail in (("Lower", (-1, 0, 0), (-0.1, 0, 0)), ("Upper", (-0.1, 0, 0), (1, 0, 0))):
        bone = armature.data.edit_bones.new(name)
        bone.head, bone.tail = head, tail
    bpy.ops.object.mode_set(mode="OBJECT")
    share = np.clip((positions(obj.data)[:, 0] + 0.4) / 0.6, 0, 1)
    set_weights(obj, "Upper", share)
    set_weights(obj, "Lower", 1 - share)
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    return armature


def test_keys_rotate_with_the_targets_pose(source):
    add_keys(source)
    armature = rigged(source)
    bend(source, armature, 1.4)
    posed = link("Target", bpy.data.meshes.new_from_object(source.evaluated_get(bpy.context.evaluated_depsgraph_get())))
    truth = {name: played(source, name) for name in ("Swell", "Slide")}
    for angle in (1.4, 0.0, -0.8):  # however the source stands while it is read
        bend(source, armature, angle)
        keep_match(posed, positions(source.data))
        transfer(source, posed)
        for name, offsets in truth.items():
            assert error(played(posed, name), offsets) < 0.1
    assert error(swelling(positions(source.data)), truth["Swell"]) > 1


def test_armatures_act_after_transferred_keys(source, target):
    add_keys(source)
    armature = rigged(source)
    bend(source, armature, -0.7)
    other = rigged(target)
    bend(target, other, 1.4)
    keep_match(target, positions(target.data))
    transfer(source, target)
    points = positions(target.data)
    np.testing.assert_allclose(key_shape(target.data, "Basis"), points)
    for name, offsets in (("Swell", swelling(points)), ("Slide", sliding(points))):
        assert error(key_shape(target.data, name) - points, offsets) < 0.03


def test_drivers_are_transferred_to_the_target(source, target):
    add_keys(source)
    source["slider"] = 0.0
    key = source.data.shape_keys
    driver = blocks(source)["Swell"].driver_add("value").driver
    driver.type = "SUM"
    end = driver.variables.new().targets[0]
    end.id, end.data_path = source, '["slider"]'
    driver = blocks(source)["Slide"].driver_add("value").driver
    driver.type = "SUM"
    variable = driver.variables.new()
    variable.targets[0].id_type = "KEY"
    variable.targets[0].id, variable.targets[0].data_path = key, 'key_blocks["Swell"].value'
    for _ in range(2):  # the second time in place of the first
        transfer(source, target)
    paths = [curve.data_path for curve in target.data.shape_keys.animation_data.drivers]
    assert paths == ['key_blocks["Swell"].value', 'key_blocks["Slide"].value']
    ends = [curve.driver.variables[0].targets[0].id for curve in target.data.shape_keys.animation_data.drivers]
    assert ends == [source, target.data.shape_keys]

    still = visible_positions(target)
    source["slider"] = 0.5
    source.update_tag()
    points = positions(target.data)
    expected = 0.5 * (swelling(points) + sliding(points))
    assert error(visible_positions(target) - still, expected) < 0.03


def test_action_is_copied_unless_target_has_one(source, target):
    add_keys(source)
    swell = blocks(source)["Swell"]
    for frame, value in ((1, 0.0), (11, 1.0)):
        swell.value = value
        swell.keyframe_insert("value", frame=frame)
    transfer(source, target)
    action = target.data.shape_keys.animation_data.action
    assert action not in (None, source.data.shape_keys.animation_data.action)
    bpy.context.scene.frame_set(11)
    at_end = visible_positions(target)
    bpy.context.scene.frame_set(1)
    points = positions(target.data)
    assert error(at_end - visible_positions(target), swelling(points)) < 0.03

    report = transfer(source, target)
    assert target.data.shape_keys.animation_data.action == action
    assert any("keep their current action" in note for note in report["notes"])


def test_absolute_keys_are_refused_with_a_sentence(source, target):
    add_keys(source)
    source.data.shape_keys.use_relative = False
    source.data.materials.append(bpy.data.materials.new("red"))
    report = transfer(source, target, "shape_keys", "materials")
    assert "absolute" in report["skipped"]["shape keys"]
    assert target.data.shape_keys is None

    source.data.shape_keys.use_relative = True
    add_keys(target)
    target.data.shape_keys.use_relative = False
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="'Target' are absolute"):
        transfer(source, target)
    assert snapshot_file() == before


def test_key_named_like_the_targets_basis_is_refused(source, target):
    add_keys(source)
    target.shape_key_add(name="Slide", from_mix=False)
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="'Slide' is the Basis shape key"):
        transfer(source, target)
    assert snapshot_file() == before


@pytest.mark.parametrize("deforms", ["modifier", "parent"])
def test_keys_pass_through_modifiers_that_add_vertices(source, target, deforms):
    add_keys(source)
    armature = rigged(source)
    if deforms == "parent":
        source.modifiers.clear()
        source.parent, source.parent_type = armature, "ARMATURE"
    first, second = (add_key(source, name, swelling(positions(source.data))) for name in ("Round", "About"))
    first.relative_key, second.relative_key = second, first
    finer = source.modifiers.new("Finer", "SUBSURF")
    finer.levels, finer.subdivision_type = 1, "SIMPLE"
    keep_match(target, positions(target.data))
    bend(source, armature, 1.0)
    blocks(source)["Slide"].driver_add("value").driver.expression = "0.3"
    bpy.context.view_layer.update()
    before = snapshot_file()
    points = positions(target.data)
    report = transfer(source, target)
    assert report["written"]["shape_keys"] == ["Swell", "Slide", "Round", "About"]
    blocks_after, objects_after = snapshot_file()
    assert objects_after["Source"] == before[1]["Source"]
    assert blocks_after["objects"] == before[0]["objects"]
    assert blocks_after["meshes"] == before[0]["meshes"]
    assert len(blocks_after["shape_keys"]) == len(before[0]["shape_keys"]) + 1
    target.data.shape_keys.animation_data_clear()
    assert error(played(target, "Swell"), swelling(points)) < 0.05
    assert error(played(target, "Slide"), sliding(points)) < 0.05
    assert error(key_shape(target.data, "Round") - points, swelling(points)) < 0.05


def test_shape_dependent_modifiers_are_refused(source, target):
    add_keys(source)
    source.modifiers.new("Fewer", "DECIMATE").ratio = 0.5
    source.data.materials.append(bpy.data.materials.new("red"))
    keep_match(target, positions(target.data))
    report = transfer(source, target, "shape_keys", "materials")
    assert "modifiers" in report["skipped"]["shape keys"]
    assert target.data.shape_keys is None


def test_shape_keys_are_part_of_one_undo_step(source, target):
    add_keys(source)
    activate(target, source)
    bpy.ops.ed.undo_push(message="before")
    before = snapshot_file()
    assert bpy.ops.zoomout.transfer("EXEC_DEFAULT", True) == {"FINISHED"}
    assert transfer_report(target)["written"]["shape_keys"] == ["Swell", "Slide"]
    bpy.ops.ed.undo()
    assert snapshot_file() == before


def test_a_source_without_keys_gives_none(source, target):
    source.data.materials.append(bpy.data.materials.new("red"))
    transfer(source, target, "shape_keys", "materials")
    source.shape_key_add(name="Basis")
    report = transfer(source, target, "shape_keys", "materials")
    assert report["written"]["shape_keys"] == []
    assert target.data.shape_keys is None


def test_the_shape_of_the_source_becomes_a_key_in_the_targets_place(source):
    other = ellipsoid("Target", radii=(0.6, 0.9, 0.5))
    keep_match(other, positions(source.data))
    for obj, place, scale in ((source, (5, 0, 0), 2.0), (other, (-3, 1, 0), 0.5)):
        obj.matrix_world = Matrix.LocRotScale(place, None, (scale, scale, scale))
    bpy.context.view_layer.update()
    keep_match(other, positions(source.data))
    before = positions(other.data)
    report = transfer(source, other, "shape")
    assert report["written"]["shape"] == ["Source"]
    key = blocks(other)["Source"]
    assert key.value == 0
    np.testing.assert_array_equal(positions(other.data), before)
    key.value = 1
    seen = visible_positions(other) - other.matrix_world.translation
    np.testing.assert_allclose(seen, 2 * positions(source.data), atol=1e-4)


def test_the_shape_is_transferred_only_if_it_is_asked_for(source, target):
    add_keys(source)
    assert transfer_objects(bpy.context, source, target)["written"]["shape"] == []
    activate(target, source)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    assert "Source" not in blocks(target)
    assert bpy.ops.zoomout.transfer(shape=True) == {"FINISHED"}
    assert "Source" in blocks(target)


def test_a_flat_target_is_refused(source):
    add_keys(source)
    plane = from_pydata("Target", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])
    plane.scale.z = 0
    keep_match(plane, positions(plane.data))
    with pytest.raises(zo.MeshError, match="scale of zero"):
        transfer(source, plane)
