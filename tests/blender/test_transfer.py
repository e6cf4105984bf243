# SPDX-License-Identifier: GPL-3.0-or-later
"""Transferring data between two objects along a true match."""

import json
from functools import partial
from itertools import islice
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from drawing import Layout
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    decimate,
    ellipsoid,
    link,
    new_material,
    positions,
    set_weights,
    snapshot,
    snapshot_file,
    values,
    weight_array,
    weights,
)
from true_match import keep_true_match
from turns import turns

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.adapters import DATA
from blender_addon.jobs import Job
from blender_addon.operators.bind_to_rig import ZOOMOUT_OT_bind_to_rig
from blender_addon.operators.matching.match import ZOOMOUT_OT_match
from blender_addon.operators.transfer import ZOOMOUT_OT_transfer
from blender_addon.properties.match import MatchOptions
from blender_addon.scene.selection import own_sources
from blender_addon.services import transfer as service
from blender_addon.services.matching.made_match import MatchUse
from blender_addon.services.matching.match import match_objects
from blender_addon.services.transfer import prepare_transfer, transfer_objects
from blender_addon.storage import stored_match
from blender_addon.storage.stored_report import transfer_report


@pytest.fixture
def source():
    return ellipsoid("Source")


@pytest.fixture
def target(source):
    """The source's shape with fewer triangles at the same place, and its true match."""
    obj = decimate()
    keep_true_match(obj, doubtful=10, notes=["A note."])
    return obj


def ramp(obj, axis=0):
    """(n,) from 0 to 1 along an axis."""
    coordinate = positions(obj.data)[:, axis]
    return (coordinate - coordinate.min()) / np.ptp(coordinate)


def corner_vertices(mesh):
    array = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", array)
    return array


def face_centres(mesh):
    array = np.empty(3 * len(mesh.polygons), np.float32)
    mesh.polygons.foreach_get("center", array)
    return array.reshape(-1, 3)


def transfer(source, target, *data):
    return transfer_objects(bpy.context, source, target, data)


def test_uv_maps_keep_names_values_and_flags(source, target):
    add_uv_map(target.data, "Own")
    for name in ("First", "Second", "Third"):
        add_uv_map(source.data, name)
    source.data.uv_layers.active = source.data.uv_layers["Second"]
    source.data.uv_layers["Third"].active_render = True
    own = values(target.data, "Own").copy()

    transfer(source, target, "uv_maps")
    assert target.data.uv_layers.keys() == ["Own", "First", "Second", "Third"]
    assert target.data.uv_layers.active.name == "Second"
    assert [layer.name for layer in target.data.uv_layers if layer.active_render] == ["Third"]
    expected = positions(target.data)[corner_vertices(target.data), :2] / 4 + 0.5
    for name in ("First", "Second", "Third"):
        assert np.abs(values(target.data, name) - expected).max() < 0.01
    np.testing.assert_array_equal(values(target.data, "Own"), own)


def test_too_many_uv_maps_are_refused_before_writing(source, target):
    for i in range(5):
        add_uv_map(source.data, f"Source {i}")
    for i in range(4):
        add_uv_map(target.data, f"Target {i}")
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match=r"9 UV maps.*limit is 8"):
        transfer(source, target, "uv_maps", "materials")
    assert snapshot_file() == before
    target.data.uv_layers.remove(target.data.uv_layers["Target 3"])
    transfer(source, target, "uv_maps")
    assert len(target.data.uv_layers) == 8


def test_weights_sum_to_one_and_groups_keep_their_order(source, target):
    set_weights(target, "Own", np.full(len(target.data.vertices), 0.3))
    set_weights(target, "Right", np.ones(len(target.data.vertices)))
    set_weights(source, "Left", 1 - ramp(source))
    set_weights(source, "Right", ramp(source))
    transfer(source, target, "vertex_groups")
    assert [group.name for group in target.vertex_groups] == ["Own", "Left", "Right"]
    left, right = weight_array(target, "Left"), weight_array(target, "Right")
    assert np.abs(right - ramp(target)).max() < 0.02
    np.testing.assert_allclose(left + right, 1, atol=1e-6)
    np.testing.assert_allclose(weight_array(target, "Own"), 0.3, atol=1e-7)


def test_empty_groups_are_transferred_and_reported(source, target):
    source.vertex_groups.new(name="Empty")
    source.update_tag()
    report = transfer(source, target, "vertex_groups")
    assert weights(target) == {"Empty": {}}
    assert any("no weights" in note for note in report["notes"])


def test_locked_groups_stay_and_others_share_the_remainder(source, target):
    set_weights(source, "Left", 0.9 * (1 - ramp(source)))
    set_weights(source, "Right", 0.9 * ramp(source))
    set_weights(source, "Held", np.full(len(source.data.vertices), 0.1))
    held = 0.8 * ramp(target, axis=1)
    set_weights(target, "Held", held).lock_weight = True
    before = weights(target)["Held"]
    report = transfer(source, target, "vertex_groups")
    assert weights(target)["Held"] == before
    assert target.vertex_groups["Held"].lock_weight
    total = sum(weight_array(target, name) for name in ("Left", "Right", "Held"))
    np.testing.assert_allclose(total, 1, atol=1e-6)
    assert "locked" in report["skipped"]["Held"]
    assert report["written"]["vertex_groups"] == ["Left", "Right"]
    assert any("treated as bone weights" in note for note in report["notes"])


def test_without_an_armature_groups_are_masks_unless_they_sum_to_one(source, target):
    set_weights(source, "Mask", np.full(len(source.data.vertices), 0.4))
    set_weights(source, "Other", ramp(source))
    for name in ("Unrelated", "Other"):
        set_weights(target, name, np.full(len(target.data.vertices), 0.7)).lock_weight = True
    report = transfer(source, target, "vertex_groups")
    np.testing.assert_allclose(weight_array(target, "Mask"), 0.4, atol=1e-5)
    np.testing.assert_allclose(weight_array(target, "Other"), 0.7, atol=1e-6)
    assert any("treated as masks" in note for note in report["notes"])


def test_vertices_that_locked_groups_take_up_are_counted_in_the_report(source, target):
    set_weights(source, "Left", 1 - ramp(source))
    set_weights(source, "Right", ramp(source))
    full = ramp(target, axis=1) > 0.5
    set_weights(target, "Right", full.astype(float)).lock_weight = True
    report = transfer(source, target, "vertex_groups")
    assert (weight_array(target, "Left")[full] == 0).all()
    np.testing.assert_allclose(weight_array(target, "Left")[~full & (ramp(target) < 0.9)], 1, atol=1e-6)
    (note,) = [note for note in report["notes"] if "leave no weight for other groups" in note]
    without = full & (ramp(target) < 0.999)
    assert int(note.split(" on ")[1].split()[0]) == pytest.approx(without.sum(), abs=5)


def test_parent_armature_counts_as_deforming(source, target):
    armature = rig(("Left", "Right"))
    source.parent, source.parent_type = armature, "ARMATURE"
    keep_true_match(target, doubtful=10, notes=["A note."])
    set_weights(source, "Left", 1 - ramp(source))
    set_weights(source, "Right", ramp(source))
    set_weights(source, "Mask", np.full(len(source.data.vertices), 0.4))
    report = transfer(source, target, "vertex_groups")
    np.testing.assert_allclose(weight_array(target, "Left") + weight_array(target, "Right"), 1, atol=1e-6)
    np.testing.assert_allclose(weight_array(target, "Mask"), 0.4, atol=1e-5)
    assert not any("No armature" in note for note in report["notes"])


def rig(bones, controls=()):
    """An armature with deforming and other bones."""
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(armature)
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    for name in (*bones, *controls):
        bone = armature.data.edit_bones.new(name)
        bone.tail = (0, 0, 1)
        bone.use_deform = name not in controls
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def test_only_groups_of_deforming_bones_are_normalised(source, target):
    source.modifiers.new("Armature", "ARMATURE").object = rig(("Left", "Right"), ("Control",))
    keep_true_match(target, doubtful=10, notes=["A note."])
    set_weights(source, "Left", 1 - ramp(source))
    set_weights(source, "Right", ramp(source))
    set_weights(source, "Control", np.full(len(source.data.vertices), 0.9))
    set_weights(source, "Mask", np.full(len(source.data.vertices), 0.4))
    set_weights(target, "Locked mask", np.ones(len(target.data.vertices))).lock_weight = True  # takes no share
    transfer(source, target, "vertex_groups")
    np.testing.assert_allclose(weight_array(target, "Left") + weight_array(target, "Right"), 1, atol=1e-6)
    np.testing.assert_allclose(weight_array(target, "Control"), 0.9, atol=1e-5)
    np.testing.assert_allclose(weight_array(target, "Mask"), 0.4, atol=1e-5)


@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
@pytest.mark.parametrize("data_type", ["BYTE_COLOR", "FLOAT_COLOR"])
def test_colors_keep_domain_and_type_and_are_mixed_scene_linear(source, target, data_type, domain):
    linear = np.stack([ramp(source), 1 - ramp(source), 0 * ramp(source), 0 * ramp(source) + 1], axis=1)
    at = corner_vertices(source.data) if domain == "CORNER" else np.arange(len(linear))
    for name in ("Under", "Paint"):
        add_attribute(source.data, name, data_type, domain, linear[at])
    source.data.attributes.active_color_name = "Paint"
    source.data.attributes.default_color_name = "Under"
    target.data.color_attributes.new("Own", "FLOAT_COLOR", "POINT")

    transfer(source, target, "color_attributes")
    written = target.data.color_attributes["Paint"]
    assert (written.data_type, written.domain) == (data_type, domain)
    assert set(target.data.color_attributes.keys()) == {"Own", "Under", "Paint"}
    assert target.data.attributes.active_color_name == "Paint"
    assert target.data.attributes.default_color_name == "Under"
    at = corner_vertices(target.data) if domain == "CORNER" else np.arange(len(target.data.vertices))
    assert np.abs(values(target.data, "Paint")[:, 0] - ramp(target)[at]).max() < 0.03


def test_attributes_of_points_faces_and_corners_arrive(source, target):
    points, centres = positions(source.data), face_centres(source.data)
    add_attribute(source.data, "height", "FLOAT", "POINT", points[:, 2])
    add_attribute(source.data, "place", "FLOAT_VECTOR", "CORNER", points[corner_vertices(source.data)])
    add_attribute(source.data, "density", "FLOAT", "FACE", centres[:, 0])
    add_attribute(source.data, "zone", "INT", "FACE", np.where(centres[:, 0] > 0, 700, -3))
    add_attribute(source.data, "mask", "BOOLEAN", "POINT", points[:, 1] > 0)
    add_attribute(source.data, "level", "INT8", "POINT", np.where(points[:, 1] > 0, 5, -5))
    add_attribute(target.data, "own", "FLOAT", "POINT", np.arange(len(target.data.vertices)))
    transfer(source, target, "attributes")

    points, centres = positions(target.data), face_centres(target.data)
    assert np.abs(values(target.data, "height") - points[:, 2]).max() < 0.01
    assert np.abs(values(target.data, "place") - points[corner_vertices(target.data)]).max() < 0.01
    assert np.abs(values(target.data, "density") - centres[:, 0]).max() < 0.05
    assert set(values(target.data, "zone")) == {700, -3}
    assert ((values(target.data, "zone") == 700) == (centres[:, 0] > 0)).mean() > 0.98
    assert (values(target.data, "mask") == (points[:, 1] > 0)).mean() > 0.98
    assert target.data.attributes["level"].data_type == "INT8"
    assert set(values(target.data, "level")) == {5, -5}
    np.testing.assert_array_equal(values(target.data, "own"), np.arange(len(points)))


def test_materials_are_matched_by_identity_or_appended(source, target):
    red, green, blue = (new_material(name) for name in ("red", "green", "blue"))
    for material in (red, green, blue):
        source.data.materials.append(material)
    for material in (blue, green):
        target.data.materials.append(material)
    east = face_centres(source.data)[:, 0] > 0
    source.data.polygons.foreach_set("material_index", np.where(east, 0, 2).astype(np.int32))
    report = transfer(source, target, "materials")

    assert target.data.materials.keys() == ["blue", "green", "red"]
    shown = np.array([target.data.materials[polygon.material_index].name for polygon in target.data.polygons])
    assert set(shown) == {"red", "blue"}
    assert ((shown == "red") == (face_centres(target.data)[:, 0] > 0)).mean() > 0.98
    assert sorted(report["written"]["materials"]) == ["blue", "red"]


def dress(source):
    """Add some data of every kind to the source."""
    for name in ("UV A", "UV B"):
        add_uv_map(source.data, name)
    set_weights(source, "Left", 1 - ramp(source))
    set_weights(source, "Right", ramp(source))
    source.data.color_attributes.new("Paint", "BYTE_COLOR", "CORNER")
    add_attribute(source.data, "height", "FLOAT", "POINT", positions(source.data)[:, 2])
    source.data.materials.append(new_material("red"))


def test_failed_transfer_changes_nothing(source, target):
    dress(source)
    unknown = np.full_like(values(source.data, "UV B"), np.nan)
    source.data.attributes["UV B"].data.foreach_set("vector", unknown.ravel())
    activate(target, source)
    before = snapshot_file()
    with pytest.raises(RuntimeError, match="Error: 'UV B' has no finite values"):
        bpy.ops.zoomout.transfer()
    assert snapshot_file() == before


def test_a_transfer_writes_nothing_before_its_end(source, target):
    dress(source)
    for name in list(target.data.attributes.keys()):
        if name.startswith("zoomout_"):  # so that it has to match first
            target.data.attributes.remove(target.data.attributes[name])
    before = snapshot_file()
    job = Job(prepare_transfer(bpy.context, "Source", "Target", ("uv_maps", "materials"), k_final=30))
    assert len([*islice(turns(job), 5)]) == 5
    job.cancel()
    assert snapshot_file() == before

    fractions = []
    job = Job(service.transfer(bpy.context, "Source", "Target", ("uv_maps", "vertex_groups"), k_final=30))
    for progress in turns(job):
        fractions.append(progress.fraction)
        assert snapshot_file() == before
    assert fractions == sorted(fractions)
    assert snapshot_file() != before


def test_one_transfer_is_one_undo_step(source, target):
    dress(source)
    activate(target, source)
    bpy.ops.ed.undo_push(message="before")
    before = snapshot_file()
    assert bpy.ops.zoomout.transfer("EXEC_DEFAULT", True) == {"FINISHED"}
    after = snapshot_file()
    assert after != before
    bpy.ops.ed.undo()
    assert snapshot_file() == before
    bpy.ops.ed.redo()
    assert snapshot_file() == after


def test_group_named_like_an_attribute_is_noted(source, target):
    dress(source)
    add_attribute(target.data, "Left", "FLOAT", "POINT", np.zeros(len(target.data.vertices)))
    report = transfer(source, target, "vertex_groups")
    assert any("(Left)" in note for note in report["notes"])
    assert np.abs(weight_array(target, "Left") - (1 - ramp(target))).max() < 0.02


def test_an_attribute_that_bears_the_name_of_a_vertex_group_is_refused(source, target):
    dress(source)
    set_weights(target, "height", ramp(target))
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="'height'"):
        transfer(source, target, "attributes")
    assert snapshot_file() == before


def test_only_what_is_chosen_is_transferred(source, target):
    dress(source)
    activate(target, source)
    before = snapshot(target)
    bpy.context.scene.zoomout.color_attributes = False
    nothing = dict.fromkeys(("uv_maps", "attributes", "materials"), False)
    assert bpy.ops.zoomout.transfer(**nothing) == {"FINISHED"}
    after = snapshot(target)
    assert list(after["weights"]) == ["Left", "Right"]
    assert after["attributes"] == before["attributes"]
    assert after["materials"] == before["materials"]


def test_an_unknown_kind_of_data_is_an_error(source, target):
    with pytest.raises(ValueError, match="uvs"):
        transfer(source, target, "uvs")


def test_nothing_to_transfer_is_an_error(source, target):
    with pytest.raises(zo.MeshError, match="'Source' has none of the data"):
        transfer(source, target, "uv_maps", "materials")


def test_stored_match_is_used_and_a_missing_one_is_computed(source, target, monkeypatch):
    dress(source)
    target_without = link("Without", target.data.copy())
    for name in ("zoomout_triangle", "zoomout_barycentric", "zoomout_confidence"):
        target_without.data.attributes.remove(target_without.data.attributes[name])
    report = transfer_objects(bpy.context, source, target_without, ["attributes"], initial="proximity")
    assert report["written"]["attributes"] == ["height", "sharp_face"]
    assert np.abs(values(target_without.data, "height") - positions(target_without.data)[:, 2]).mean() < 0.02
    assert stored_match.description(target_without.data)["source"] == "Source"

    monkeypatch.setattr("zoomout_core.match", None)
    transfer(source, target, "attributes")
    assert np.abs(values(target.data, "height") - positions(target.data)[:, 2]).max() < 0.01


@pytest.mark.slow
def test_settings_without_effect_on_a_stored_match_are_reported(source, target):
    dress(source)
    activate(target, source)

    def unused(**options):
        assert bpy.ops.zoomout.transfer(attributes=True, **options) == {"FINISHED"}
        return [note for note in transfer_report(target)["notes"] if "existing match" in note]

    assert bpy.ops.zoomout.match(initial="PROXIMITY", k_final=30) == {"FINISHED"}
    assert unused(initial="PROXIMITY", k_final=30) == []
    (note,) = unused(initial="PROXIMITY", k_final=60)
    assert "(Map Resolution)" in note
    (note,) = unused()
    assert "(Method, Landmarks, Names, Same Up Axis, Last Match, Upright, Map Resolution)" in note
    target.data.attributes.remove(target.data.attributes["zoomout_triangle"])
    assert unused(initial="PROXIMITY", k_final=40) == []
    assert unused(initial="PROXIMITY", k_final=40) == []


def test_matched_source_is_the_default(source, target):
    dress(source)
    activate(target)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    assert bpy.ops.zoomout.match() == {"FINISHED"}
    assert stored_match.description(target.data)["source"] == "Source"
    source.name = "Renamed"
    with pytest.raises(RuntimeError, match="There is no source"):
        bpy.ops.zoomout.match()


def test_adjusting_reuses_the_computed_match(source, target, monkeypatch):
    dress(source)
    target.data.attributes.remove(target.data.attributes["zoomout_triangle"])
    transfer_objects(bpy.context, source, target, ["uv_maps"], k_final=30)
    confidence = values(target.data, "zoomout_confidence")
    target.data.attributes.remove(target.data.attributes["zoomout_triangle"])
    monkeypatch.setattr("zoomout_core.match", None)
    use = MatchUse(adjusted=True)
    adjusted = partial(prepare_transfer, bpy.context, "Source", "Target", ["vertex_groups"], use=use)
    report = jobs.run(adjusted())()
    assert report["source"] == "Source"
    np.testing.assert_array_equal(values(target.data, "zoomout_confidence"), confidence)
    # It is not a map of other meshes.
    target.data.attributes.remove(target.data.attributes["zoomout_triangle"])
    target.data.vertices[0].co.x += 0.1
    bpy.context.view_layer.update()
    with pytest.raises(TypeError, match="callable"):
        jobs.run(adjusted())


def test_redo_panel_shows_only_adjustable_settings(target):
    drawn = []
    for operator in (ZOOMOUT_OT_transfer, ZOOMOUT_OT_match, ZOOMOUT_OT_bind_to_rig):
        rna = getattr(bpy.ops.zoomout, operator.bl_idname.split(".")[1]).get_rna_type()
        operator.draw(SimpleNamespace(layout=Layout(drawn), bl_rna=rna), bpy.context)
    names = {text for kind, text, _ in drawn if kind == "prop"}
    assert {"uv_maps", "fill_below", "limit", "binding"} <= names
    assert not names & MatchOptions.__annotations__.keys()


def test_several_targets_keep_their_own_sources_where_none_is_chosen(source, target):
    first, second = target, ellipsoid("Second", 3)
    other = ellipsoid("Other", 3)
    other.vertex_groups.new(name="Of other").add([0, 1, 2], 1, "REPLACE")
    source.vertex_groups.new(name="Of source").add([0, 1, 2], 1, "REPLACE")
    match_objects(bpy.context, source, first, k_final=30)
    match_objects(bpy.context, other, second, k_final=30)
    activate(first, second)
    assert own_sources(bpy.context) == {"Target": "Source", "Second": "Other"}
    assert bpy.ops.zoomout.transfer(uv_maps=False) == {"FINISHED"}
    assert "Of source" in first.vertex_groups
    assert second.vertex_groups.keys() == ["Of other"]
    # The object selected, or chosen, beside the target is its source if it is eligible.
    activate(first, other)
    assert own_sources(bpy.context) == {}
    match_objects(bpy.context, source, second, k_final=30)
    activate(first, second)
    assert own_sources(bpy.context) == {}
    activate(first, second)
    bpy.context.scene.zoomout.source = other
    assert own_sources(bpy.context) == {}


def test_a_match_that_is_out_of_date_is_refused(source, target):
    dress(source)
    source.data.vertices[100].co.x += 1
    bpy.context.view_layer.update()
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="match again"):
        transfer(source, target, "uv_maps")
    assert snapshot_file() == before
    match_objects(bpy.context, source, target, initial="proximity", k_final=30)
    transfer(source, target, "uv_maps")


def test_repeated_transfer_changes_only_updated_data(source, target):
    dress(source)
    transfer_objects(bpy.context, source, target)
    first = snapshot(target)
    transfer_objects(bpy.context, source, target)
    assert snapshot(target) == first
    source.data.attributes["height"].data.foreach_set("value", np.ones(len(source.data.vertices), np.float32))
    source.data.update()
    transfer_objects(bpy.context, source, target)
    second = snapshot(target)
    assert {name for name in first["attributes"] if first["attributes"][name] != second["attributes"][name]} == {
        "height"
    }


def test_report_lists_written_and_skipped_data(source, target):
    dress(source)
    for name in ("Basis", "Smile"):
        source.shape_key_add(name=name)
    source.modifiers.new("Sculpted", "MULTIRES")
    add_attribute(target.data, "height", "INT", "FACE", np.zeros(len(target.data.polygons)))
    activate(target, source)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    report = transfer_report(target)
    assert json.loads(json.dumps(report)) == report
    assert (report["source"], report["target"]) == ("Source", "Target")
    assert report["written"] == {
        "uv_maps": ["UV A", "UV B"],
        "color_attributes": ["Paint"],
        "attributes": ["height", "sharp_face"],
        "vertex_groups": ["Left", "Right"],
        "shape_keys": ["Smile"],
        "materials": ["red"],
        "edges": [],
        "custom_normals": [],
        "shape": [],
    }
    assert list(report["skipped"]) == ["multires displacement"]
    assert (report["vertices"], report["low_confidence"]) == (len(target.data.vertices), 10)
    assert report["notes"][0] == "A note."
    assert any(note.startswith("height: replaced") for note in report["notes"])
    assert transfer_report(source) is None


def test_shared_mesh_is_written_once_and_reported(source, target):
    dress(source)
    other = link("Twin", target.data)
    report = transfer_objects(bpy.context, source, target)
    assert any("shared by 2 objects" in note for note in report["notes"])
    assert [group.name for group in other.vertex_groups] == ["Left", "Right"]
    assert other.material_slots[0].material.name == "red"


def test_source_modifiers_apply_to_transferred_data(source, target):
    dress(source)
    finer = source.modifiers.new("Finer", "SUBSURF")
    finer.levels, finer.subdivision_type = 1, "SIMPLE"
    keep_true_match(target, doubtful=10, notes=["A note."])
    transfer_objects(bpy.context, source, target)
    assert np.abs(values(target.data, "height") - positions(target.data)[:, 2]).max() < 0.01
    assert np.abs(weight_array(target, "Right") - ramp(target)).max() < 0.02


@pytest.mark.slow
def test_all_kinds_together_equal_each_alone(source, target):
    dress(source)
    points = positions(source.data)
    source.data.shade_smooth()
    source.data.normals_split_custom_set_from_vertices(points / np.linalg.norm(points, axis=1, keepdims=True))
    ends = np.array([edge.vertices[:] for edge in source.data.edges])
    source.data.edges.foreach_set("use_seam", (points[ends][:, :, 2] > 0.5).all(axis=1))
    for name in ("Basis", "Smile"):
        key = source.shape_key_add(name=name)
    key.data[7].co.z += 0.1
    finer = source.modifiers.new("Finer", "SUBSURF")  # so that keys are read from copies that are evaluated
    finer.levels, finer.subdivision_type = 1, "SIMPLE"
    alone = link("Alone", target.data.copy())
    for obj in (target, alone):
        keep_true_match(obj, doubtful=10, notes=["A note."])
    report = transfer_objects(bpy.context, source, target, DATA)
    assert all(report["written"].values()), report["written"]
    for kinds in (("uv_maps", "edges"), *((kind,) for kind in DATA if kind not in ("uv_maps", "edges"))):
        transfer_objects(bpy.context, source, alone, kinds)  # seams are where UV maps have them, if there are any
    together, apart = snapshot(target), snapshot(alone)
    for one in (together, apart):
        one.pop("properties")  # the report
    assert apart == together
