# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators along a mesh's own symmetry: posed, and with different topology on its two sides."""

import json
from itertools import islice

import bpy
import numpy as np
import pytest
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    delete_vertex,
    key_shape,
    new_material,
    positions,
    set_weights,
    snapshot,
    values,
    weight_array,
    weights,
)
from symmetric import BENT, LEFT, RIGHT, TIP, X, add_key, bumps, edges_between, key_offsets, new_object, off_by
from turns import finish, turns

import zoomout_core as zo
from blender_addon import jobs, mesh_data
from blender_addon.services.symmetry.check import check_symmetry_async
from blender_addon.services.symmetry.detect import choose_symmetry, detect_symmetry, detect_symmetry_async
from blender_addon.services.symmetry.layers import mirror_attributes, mirror_attributes_async
from blender_addon.services.symmetry.sculpt import mirror_sculpt, mirror_sculpt_async
from blender_addon.services.symmetry.shape_keys import mirror_shape_key, mirror_shape_key_async
from blender_addon.services.symmetry.sides import name_sides, select_symmetry_line
from blender_addon.services.symmetry.weights import symmetrise_weights, symmetrise_weights_async
from blender_addon.storage import stored_symmetry


def test_symmetry_is_detected_and_stored(found):
    obj = new_object()
    activate(obj)
    assert bpy.ops.zoomout.detect_symmetry() == {"FINISHED"}
    kept = stored_symmetry.description(obj.data)
    assert kept["candidates"][0]["name"] == "Reflection"
    symmetry = stored_symmetry.read(obj)
    images = symmetry.surface_map.interpolate(BENT.surface.vertices)
    np.testing.assert_allclose(images, found[0].surface_map.interpolate(BENT.surface.vertices), atol=1e-4)
    assert ((symmetry.distance > 0) == LEFT)[LEFT | RIGHT].mean() > 0.99


def test_axis_defines_left_and_sides_can_be_swapped(body):
    before = stored_symmetry.read(body).distance
    assert bpy.ops.zoomout.swap_sides() == {"FINISHED"}
    np.testing.assert_array_equal(stored_symmetry.read(body).distance, -before)
    detect_symmetry(bpy.context, body, "-X")
    assert (stored_symmetry.read(body).distance[LEFT] < 0).mean() > 0.99


def test_candidates_can_be_chosen(body, found):
    stored_symmetry.write(body, (found[0], found[0]), "X")
    assert bpy.ops.zoomout.choose_symmetry(number=1) == {"FINISHED"}
    assert stored_symmetry.description(body.data)["chosen"] == 1
    with pytest.raises(zo.MeshError, match="'Creature' has only 2 symmetries"):
        choose_symmetry(bpy.context, body, 2)


def test_cancelled_or_edited_detection_changes_nothing():
    obj = new_object()
    activate(obj)
    before = snapshot(obj)
    job = jobs.Job(detect_symmetry_async(bpy.context, obj.name))
    next(turns(job))
    job.cancel()
    assert snapshot(obj) == before
    job = jobs.Job(detect_symmetry_async(bpy.context, obj.name))
    next(turns(job))
    obj.data.vertices[0].co.x += 1
    before = snapshot(obj)
    with pytest.raises(zo.MeshError, match="was edited during the operation"):
        finish(job)
    assert snapshot(obj) == before


OPERATIONS = {
    "weights": lambda: symmetrise_weights_async(bpy.context, "Creature", "left_to_right"),
    "key": lambda: mirror_shape_key_async(bpy.context, "Creature", "Smile.L", "mirror", "left_to_right", 0.1),
    "attributes": lambda: mirror_attributes_async(bpy.context, "Creature", ("uv_maps",), "left_to_right", "own"),
    "sculpt": lambda: mirror_sculpt_async(bpy.context, "Creature", "left_to_right"),
    "check": lambda: check_symmetry_async(bpy.context, "Creature", "weights", ""),
}


@pytest.mark.parametrize("taken", [1, 2])
@pytest.mark.parametrize("work", OPERATIONS)
def test_edit_during_operation_is_detected_and_nothing_written(body, work, taken):
    set_weights(body, "Arm.L", np.clip(X, 0, 1))
    add_uv_map(body.data, "Atlas")
    add_key(body, "Smile.L", bumps(np.clip(X, 0, 1)))
    if work == "sculpt":
        mesh_data.move_vertices(body.data, bumps(np.clip(X, 0, 1)))
    for edit in (moved, delete_vertex):
        job = jobs.Job(OPERATIONS[work]())
        assert len([*islice(turns(job), taken)]) == taken
        edit(body)
        before = snapshot(body)
        with pytest.raises(zo.MeshError, match="'Creature' was edited during the operation: start again"):
            finish(job)
        assert snapshot(body) == before
        if edit is moved:
            mesh_data.move_vertices(body.data, -MOVE)


MOVE = np.zeros((len(X), 3))
MOVE[7] = 0.25


def moved(obj):
    mesh_data.move_vertices(obj.data, MOVE)


def test_edges_are_mirrored_in_blenders_order(body):
    mesh = body.data
    ends = np.array([edge.vertices for edge in mesh.edges])
    middle = X[ends].mean(axis=1)
    assert (np.diff(ends[:, 0]) < 0).any()  # an order of their own
    add_attribute(mesh, "height", "FLOAT", "EDGE", np.where(middle > 0, BENT.directions[ends, 2].mean(axis=1), 5))
    body.shape_key_add(name="Basis")  # positions at rest are read by themselves then
    mirror_attributes(bpy.context, body, ("attributes",))
    off = np.abs(values(mesh, "height") - BENT.directions[ends, 2].mean(axis=1))
    assert off[np.abs(middle) > 0.2].mean() < 0.05


def test_edited_mesh_is_reported(body):
    body.data.vertices[0].co.x += 0.1
    with pytest.raises(zo.MeshError, match="was reshaped since its symmetry was detected"):
        symmetrise_weights(bpy.context, body)
    body.data.clear_geometry()
    body.data.from_pydata(BENT.surface.vertices[:4].tolist(), [], [(0, 1, 2), (0, 2, 3)])
    assert stored_symmetry.is_outdated(body.data, json.loads(body.data["zoomout_symmetry"]))


def test_a_mesh_that_is_edited_through_another_object_is_left_alone(body):
    other = bpy.data.objects.new("Other", body.data)
    bpy.context.scene.collection.objects.link(other)
    activate(other)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.objects.active = body
    assert body.mode == bpy.context.mode == "OBJECT"
    assert not bpy.ops.zoomout.name_sides.poll()
    with pytest.raises(zo.MeshError, match="'Creature' is in Edit Mode"):
        mirror_sculpt(bpy.context, body)


def test_without_a_symmetry_nothing_can_be_mirrored():
    obj = new_object()
    activate(obj)
    assert not bpy.ops.zoomout.symmetrise_weights.poll()
    assert not bpy.ops.zoomout.clear_preview.poll()
    with pytest.raises(zo.MeshError, match="has no detected symmetry: detect it first"):
        symmetrise_weights(bpy.context, obj)


def test_a_posed_or_subdivided_mesh_keeps_its_symmetry(body):
    body.modifiers.new("Subdivision", "SUBSURF").levels = 1
    body.rotation_euler = (1, 2, 3)
    body.scale = (-1, 1, 1)
    bpy.context.view_layer.update()
    assert name_sides(body, 0.01).startswith("'Creature': ")


def test_weights_of_one_side_become_those_of_the_other(body):
    left = np.clip(1.5 * X, 0, 0.9)
    set_weights(body, "Arm.L", left)
    set_weights(body, "Spine", 1 - left)
    assert bpy.ops.zoomout.symmetrise_weights() == {"FINISHED"}
    right = np.clip(-1.5 * X, 0, 0.9)
    np.testing.assert_allclose(weight_array(body, "Arm.L"), left, atol=0.02)
    assert np.abs(weight_array(body, "Arm.R") - right).mean() < 0.01
    assert np.abs(weight_array(body, "Spine") - (1 - left - right)).mean() < 0.01
    total = sum(weight_array(body, name) for name in weights(body))
    np.testing.assert_allclose(total, 1, atol=1e-5)


def test_infix_sides_in_names_are_paired(body):
    left = np.clip(1.5 * X, 0, 0.9)
    set_weights(body, "mixamorig:LeftArm", left)
    set_weights(body, "mixamorig:RightArm", np.zeros(len(X)))
    assert symmetrise_weights(bpy.context, body) == "Made 2 vertex groups of 'Creature' symmetric"
    np.testing.assert_allclose(weight_array(body, "mixamorig:LeftArm"), left, atol=0.02)
    assert np.abs(weight_array(body, "mixamorig:RightArm") - np.clip(-1.5 * X, 0, 0.9)).mean() < 0.01


def test_names_without_sides_are_reported(body):
    set_weights(body, "Hat", np.clip(X, 0, 1))
    told = "Made 1 vertex groups of 'Creature' symmetric; no name has a side, so each group was made symmetric"
    assert symmetrise_weights(bpy.context, body) == told


def test_group_order_is_kept(body):
    for name in ("Arm.L", "Arm.R", "Spine"):
        set_weights(body, name, np.clip(X, 0, 1))
    symmetrise_weights(bpy.context, body, only="Arm.R")
    assert body.vertex_groups.keys() == ["Arm.L", "Arm.R", "Spine"]
    name_sides(body, 0.01)
    assert body.vertex_groups.keys()[:3] == ["Arm.L", "Arm.R", "Spine"]


def test_locked_and_other_groups_stay(body):
    set_weights(body, "Arm.L", np.clip(X, 0, 1))
    set_weights(body, "Arm.R", 0.5 * np.clip(-X, 0, 1))
    set_weights(body, "Leg.L", np.clip(X, 0, 1)).lock_weight = True
    before = weights(body)
    message = symmetrise_weights(bpy.context, body, "right_to_left")
    assert message == "Made 2 vertex groups of 'Creature' symmetric; locked groups were not changed (Leg.L, Leg.R)"
    assert np.abs(weight_array(body, "Arm.L") - 0.5 * np.clip(X, 0, 1)).mean() < 0.01
    assert weights(body)["Leg.L"] == before["Leg.L"]
    set_weights(body, "Hat", np.clip(X, 0, 1))
    symmetrise_weights(bpy.context, body, "left_to_right", only="Arm.L")
    assert np.abs(weight_array(body, "Hat") - np.clip(X, 0, 1)).max() < 1e-6
    with pytest.raises(zo.MeshError, match="no vertex group 'Wing'"):
        symmetrise_weights(bpy.context, body, "left_to_right", only="Wing")


def test_mirroring_creates_the_key_of_the_other_side(body):
    body.vertex_groups.new(name="Mask.L")
    body.vertex_groups.new(name="Mask.R")
    key = add_key(body, "Smile.L", bumps(np.clip(X, 0, 1)))
    key.slider_max, key.vertex_group, key.value = 2, "Mask.L", 0.5
    assert bpy.ops.zoomout.mirror_shape_key() == {"FINISHED"}
    assert off_by(key_offsets(body, "Smile.R"), bumps(np.clip(-X, 0, 1))) < 0.1
    made = body.data.shape_keys.key_blocks["Smile.R"]
    assert (made.slider_max, made.vertex_group, made.value) == (2, "Mask.R", 0)
    assert off_by(key_offsets(body, "Smile.L"), bumps(np.clip(X, 0, 1))) < 1e-4
    with pytest.raises(zo.MeshError, match="'Creature' has no shape key 'Frown'"):
        mirror_shape_key(bpy.context, body, "Frown")


def test_mirrored_relative_key_stays_relative(body):
    add_key(body, "Smile.L", bumps(np.clip(X, 0, 1)))
    add_key(body, "Smile.R", bumps(np.clip(-X, 0, 1)))
    more = add_key(body, "Grin.L", bumps(2 * np.clip(X, 0, 1)))
    more.relative_key = body.data.shape_keys.key_blocks["Smile.L"]
    mirror_shape_key(bpy.context, body, "Grin.L")
    made = body.data.shape_keys.key_blocks["Grin.R"]
    assert made.relative_key.name == "Smile.R"
    assert off_by(key_offsets(body, "Grin.R"), bumps(2 * np.clip(-X, 0, 1))) < 0.1


def test_keys_relative_to_a_written_key_keep_their_effect(body):
    add_key(body, "Smile", bumps(np.clip(X, 0, 1)))
    on_top = bumps(np.ones(len(X)))
    for name, base in (("Grin", "Smile"), ("Laugh", "Grin")):
        key = add_key(body, name, key_offsets(body, base) + on_top)
        key.relative_key = body.data.shape_keys.key_blocks[base]
    mirror_shape_key(bpy.context, body, "Smile", "symmetrise")
    assert off_by(key_offsets(body, "Smile"), bumps(np.abs(X))) < 0.1
    for name, base in (("Grin", "Smile"), ("Laugh", "Grin")):
        np.testing.assert_allclose(key_offsets(body, name) - key_offsets(body, base), on_top, atol=1e-5)


def test_locked_keys_are_not_written(body):
    add_key(body, "Smile.L", bumps(np.clip(X, 0, 1)))
    add_key(body, "Smile.R", bumps(np.clip(-X, 0, 1))).lock_shape = True
    before = snapshot(body)
    for mode, direction in (("mirror", "left_to_right"), ("mirror", "exchange")):
        with pytest.raises(zo.MeshError, match=r"The shape key 'Smile\.R' of 'Creature' is locked: unlock it"):
            mirror_shape_key(bpy.context, body, "Smile.L", mode, direction)
    with pytest.raises(zo.MeshError, match="is locked"):
        mirror_shape_key(bpy.context, body, "Smile.R", "symmetrise")
    assert snapshot(body) == before


def test_both_parts_of_a_split_key_keep_its_vertex_group(body):
    body.vertex_groups.new(name="Mask.L")
    body.vertex_groups.new(name="Mask.R")
    add_key(body, "Frown", bumps(np.abs(X))).vertex_group = "Mask.L"
    mirror_shape_key(bpy.context, body, "Frown", "split")
    made = body.data.shape_keys.key_blocks
    assert (made["Frown.L"].vertex_group, made["Frown.R"].vertex_group) == ("Mask.L", "Mask.L")


def test_a_key_is_split_and_made_symmetric(body):
    add_key(body, "Frown", bumps(np.abs(X)))
    mirror_shape_key(bpy.context, body, "Frown", "split")
    both = key_offsets(body, "Frown.L") + key_offsets(body, "Frown.R")
    np.testing.assert_allclose(both, key_offsets(body, "Frown"), atol=1e-5)
    far = np.abs(X) > 0.6
    assert np.abs(key_offsets(body, "Frown.L")[far & (X < 0)]).max() < 1e-5
    with pytest.raises(zo.MeshError, match="'Frown' has no side"):
        mirror_shape_key(bpy.context, body, "Frown", "mirror")
    add_key(body, "Half", bumps(np.clip(X, 0, 1)))
    mirror_shape_key(bpy.context, body, "Half", "symmetrise", "left_to_right")
    assert off_by(key_offsets(body, "Half"), bumps(np.abs(X))) < 0.1


def test_attributes_colours_masks_and_selection_are_mirrored(body):
    mesh = body.data
    height = BENT.directions[:, 2]
    add_attribute(mesh, "height", "FLOAT", "POINT", np.where(X > 0, height, 5))
    add_attribute(mesh, "Paint", "FLOAT_COLOR", "POINT", np.abs(height)[:, None] * (X > 0)[:, None] * np.ones(4))
    add_attribute(mesh, ".sculpt_mask", "FLOAT", "POINT", np.clip(X, 0, 1))
    mesh.vertices.foreach_set("select", np.ascontiguousarray(X > 0.3))
    assert bpy.ops.zoomout.mirror_attributes(masks=True, selection=True) == {"FINISHED"}
    clear = LEFT | RIGHT
    assert np.abs(values(mesh, "height") - height)[clear].mean() < 0.03
    assert np.abs(values(mesh, "Paint")[:, 0] - np.abs(height))[clear].mean() < 0.03
    assert np.abs(values(mesh, ".sculpt_mask") - np.abs(X))[clear].mean() < 0.02
    selected = np.array([vertex.select for vertex in mesh.vertices])
    assert (selected == (np.abs(X) > 0.3))[np.abs(np.abs(X) - 0.3) > 0.1].mean() > 0.99
    assert all(edge.select == all(selected[list(edge.vertices)]) for edge in mesh.edges)


def test_uv_maps_are_mirrored_in_place_or_over_each_other(body):
    mesh = body.data
    corners = BENT.directions[BENT.surface.corner_vertex]
    left = np.repeat(X[BENT.surface.triangles].mean(axis=1) > 0, 3)
    layout = corners[:, 1:] / 10 + [0.25, 0.5]
    mirrored = corners[:, 1:] * [-0.1, 0.1] + [0.75, 0.5]
    torn = mirrored + 0.01 * np.sin(300 * mirrored[:, ::-1])
    add_attribute(mesh, "Atlas", "FLOAT2", "CORNER", np.where(left[:, None], layout, torn))
    clear = np.abs(corners[:, 0]) > 0.2
    mirror_attributes(bpy.context, body, ["uv_maps"])
    off = np.linalg.norm(values(mesh, "Atlas") - np.where(left[:, None], layout, mirrored), axis=1)[clear]
    assert np.median(off) < 0.003
    mirror_attributes(bpy.context, body, ["uv_maps"], uv_layout="over")
    assert np.median(np.linalg.norm(values(mesh, "Atlas") - layout, axis=1)[clear]) < 0.003
    with pytest.raises(zo.MeshError, match="Atlas cannot be averaged"):
        mirror_attributes(bpy.context, body, ["uv_maps"], "average")
    with pytest.raises(zo.MeshError, match="none of the data"):
        mirror_attributes(bpy.context, body, ["color_attributes"])


def test_weights_and_keys_of_both_sides_are_exchanged(body):
    left, right = np.clip(X, 0, 1), np.clip(-X, 0, 1)
    for name, members in (("Arm.L", left), ("Arm.R", 0.5 * right)):
        set_weights(body, name, members)
    message = symmetrise_weights(bpy.context, body, "exchange")
    assert message == "Exchanged the sides of 2 vertex groups of 'Creature'"
    assert np.abs(weight_array(body, "Arm.L") - 0.5 * left).mean() < 0.01
    assert np.abs(weight_array(body, "Arm.R") - right).mean() < 0.01
    add_key(body, "Smile.R", bumps(0.5 * right)).value = 0.3
    add_key(body, "Smile.L", bumps(left)).value = 0.7
    assert bpy.ops.zoomout.mirror_shape_key(direction="EXCHANGE") == {"FINISHED"}
    assert off_by(key_offsets(body, "Smile.L"), bumps(0.5 * left)) < 0.1
    assert off_by(key_offsets(body, "Smile.R"), bumps(right)) < 0.1
    blocks = body.data.shape_keys.key_blocks
    assert [blocks[name].value for name in ("Smile.L", "Smile.R")] == pytest.approx([0.7, 0.3])
    add_key(body, "Wink", bumps(left))
    assert mirror_shape_key(bpy.context, body, "Wink", "symmetrise", "exchange") == "Exchanged the sides of 'Wink'"
    assert off_by(key_offsets(body, "Wink"), bumps(right)) < 0.1
    add_key(body, "Frown.L", bumps(left))
    with pytest.raises(zo.MeshError, match=r"no shape key 'Frown\.R'"):
        mirror_shape_key(bpy.context, body, "Frown.L", "mirror", "exchange")


def test_attributes_and_materials_are_exchanged(body):
    mesh = body.data
    add_attribute(mesh, "height", "FLOAT", "POINT", X)
    for name in ("Skin", "Boot.L", "Boot.R", "Patch"):
        mesh.materials.append(new_material(name))
    x, z = (BENT.directions[BENT.surface.triangles, axis].mean(axis=1) for axis in (0, 2))
    clear = (np.abs(x) > 0.1) & (np.abs(z + 0.5) > 0.1) & (np.abs(z - 0.3) > 0.1)
    boots = np.where(z < -0.5, np.where(x > 0, 1, 2), 0)
    patched = np.where((x > 0) & (z > 0.3), 3, boots)
    mesh.polygons.foreach_set("material_index", patched.astype(np.int32))
    message = mirror_attributes(bpy.context, body, ["attributes", "materials"], "exchange")
    assert message.startswith("Exchanged the sides of height, ")
    assert np.abs(values(mesh, "height") + X).mean() < 0.02
    found = np.array([polygon.material_index for polygon in mesh.polygons])
    wanted = np.where((x < 0) & (z > 0.3), 3, boots)
    assert (found == wanted)[clear].mean() > 0.98
    with pytest.raises(zo.MeshError, match="materials cannot be averaged"):
        mirror_attributes(bpy.context, body, ["materials"], "average")


@pytest.mark.parametrize(("direction", "side"), [("left_to_right", 1), ("right_to_left", -1)])
def test_edge_marks_are_mirrored(body, direction, side):
    mesh = body.data
    ends = np.array([edge.vertices[:] for edge in mesh.edges])
    x, z = BENT.directions[ends, 0], BENT.directions[ends, 2]
    belt = edges_between(mesh, BENT.directions[BENT.surface.triangles, 2].mean(axis=1) > 0)
    giving = belt & (side * x.mean(axis=1) > 0)
    mesh.edges.foreach_set("use_seam", giving)
    add_attribute(mesh, "crease_edge", "FLOAT", "EDGE", 0.5 * giving)
    add_attribute(mesh, "bevel_weight_vert", "FLOAT", "POINT", np.where(np.arange(len(X)) == TIP[side], 0.75, 0))
    mirror_attributes(bpy.context, body, ["edges"], direction)
    seams, creases = np.array([edge.use_seam for edge in mesh.edges]), values(mesh, "crease_edge")
    receiving = (side * x).max(axis=1) < -0.1
    np.testing.assert_array_equal(seams[giving], True)
    np.testing.assert_allclose(creases, 0.5 * seams, atol=1e-6)
    assert np.abs(z[seams & receiving]).max() < 0.25
    drawn, wanted = (BENT.directions[ends[some & receiving]].mean(axis=1) for some in (seams, belt))
    assert np.linalg.norm(wanted[:, None] - drawn, axis=2).min(axis=1).max() < 0.2  # without a gap
    bevelled = np.flatnonzero(values(mesh, "bevel_weight_vert"))
    assert TIP[side] in bevelled
    assert len(bevelled) == 2
    assert np.linalg.norm(BENT.directions[bevelled] - BENT.directions[TIP[-side]], axis=1).min() < 0.1


def test_sculpt_is_mirrored(body):
    rest = positions(body.data)
    with pytest.raises(zo.MeshError, match="No vertex of 'Creature' was moved"):
        mirror_sculpt(bpy.context, body)
    body.modifiers.new("Detail", "MULTIRES")
    with pytest.raises(zo.MeshError, match="stored in the levels of 'Detail'"):
        mirror_sculpt(bpy.context, body)
    body.modifiers.clear()
    add_key(body, "Smile", bumps(np.abs(X)))
    with pytest.raises(zo.MeshError, match="the sculpt is stored in the active shape key"):
        mirror_sculpt(bpy.context, body)
    moved = rest + bumps(np.clip(X, 0, 1))
    for points in (body.data.vertices, body.data.shape_keys.reference_key.points):
        points.foreach_set("co", np.ascontiguousarray(moved, np.float32).ravel())
    smile = key_shape(body.data, "Smile")
    assert bpy.ops.zoomout.mirror_sculpt() == {"FINISHED"}
    assert off_by(positions(body.data) - rest, bumps(np.abs(X))) < 0.1
    assert off_by(key_shape(body.data, "Smile") - smile, bumps(np.clip(-X, 0, 1))) < 0.15
    stored_symmetry.read(body)  # which is still good, for the next stroke


def test_the_selected_line_is_seen_in_edit_mode(body):
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    assert bpy.ops.zoomout.select_symmetry_line() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.hide()
    bpy.ops.object.mode_set(mode="OBJECT")
    hidden = np.array([vertex.hide for vertex in body.data.vertices])
    assert hidden.sum() > 30
    assert np.abs(X[hidden]).max() < 0.12


def test_the_line_is_selected_and_sides_are_named(body):
    select_symmetry_line(body)
    selected = np.array([vertex.select for vertex in body.data.vertices])
    assert np.abs(X[selected]).max() < 0.12
    assert selected.sum() > 30
    assert not any(polygon.select for polygon in body.data.polygons)
    assert bpy.ops.zoomout.name_sides(middle_width=0.02) == {"FINISHED"}
    sides = [weight_array(body, name) for name in ("Side.L", "Side.R", "Side Middle")]
    np.testing.assert_array_equal(sum(sides), 1)
    assert sides[0][X > 0.2].min() == 1
    assert sides[1][X < -0.2].min() == 1


def test_transfer_ignores_symmetry_data(body):
    from blender_addon.mesh_data import read_layers

    layers, skipped = read_layers(body.data)
    assert not [layer for layer in layers if "zoomout" in layer.attribute.name]
    assert skipped["symmetry"] == "it maps the source mesh onto itself"


def test_every_operator_and_option_has_a_description():
    from blender_addon.operators.symmetry import CLASSES

    for operator in CLASSES:
        rna = getattr(bpy.ops.zoomout, operator.bl_idname.split(".")[1]).get_rna_type()
        assert rna.description
        undone = operator.bl_idname != "zoomout.check_symmetry"  # which changes nothing
        assert operator.bl_options == ({"REGISTER", "UNDO"} if undone else {"REGISTER"})
        for option in rna.properties:
            assert option.description or option.identifier in ("rna_type", "name"), option.identifier
    for option in bpy.types.Scene.bl_rna.properties["zoomout"].fixed_type.properties["symmetry"].fixed_type.properties:
        assert option.description or option.identifier in ("rna_type", "name"), option.identifier
