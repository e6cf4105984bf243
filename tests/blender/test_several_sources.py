# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets that coincide with several objects, and receive data from all of them."""

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    decimate,
    ellipsoid,
    key_shape,
    new_material,
    positions,
    set_weights,
    snapshot_file,
    values,
    weight_array,
)

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.scene.stored_pair import read_stored_match
from blender_addon.services import preflight
from blender_addon.services.matching import previews
from blender_addon.services.matching.seam_cut import cut_seams
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from blender_addon.viewport import overlay, preview
from zoomout_core.geometry.closest_points import closest_points

# How far shape keys move what they move.
UP = np.array([0, 0, 0.1], np.float32)


def half(name, side):
    """One half of the ellipsoid, cut at x = 0."""
    obj = ellipsoid(name)
    editable = bmesh.new()
    editable.from_mesh(obj.data)
    beyond = [face for face in editable.faces if face.calc_center_median().x * side < 0]
    bmesh.ops.delete(editable, geom=beyond, context="FACES")
    editable.to_mesh(obj.data)
    editable.free()
    return obj


def joined_pair():
    return jobs.run(read_pair(bpy.context, "Front", "Whole", ["Back"]))


@pytest.fixture
def front():
    return half("Front", 1)


@pytest.fixture
def back():
    obj = half("Back", -1)
    return obj


@pytest.fixture
def whole(front, back):
    """The target, which coincides with both halves."""
    obj = decimate("Whole")
    keep_nearest(obj)
    return obj


def keep_nearest(obj):
    """Store the map to closest points of both halves on the target."""
    bpy.context.view_layer.update()
    pair = joined_pair()
    found = closest_points(pair.target.vertices, pair.source.vertices, pair.source.triangles)
    surface_map = zo.SurfaceMap(*found, pair.source.triangles)
    match = stored_match.StoredMatch(surface_map, np.ones(len(pair.target.vertices)), ())
    stored_match.write(obj.data, match, pair, {})


def ahead(obj, margin=0.05):
    """Which vertices are clearly in front, and which behind."""
    x = positions(obj.data)[:, 0]
    return x > margin, x < -margin


def transfer(front, whole, *data):
    return transfer_objects(bpy.context, front, whole, data)


def test_the_match_is_read_with_all_its_sources(whole):
    kept = stored_match.read(whole.data, joined_pair())
    assert kept.others == ("Back",)
    assert jobs.run(read_stored_match(bpy.context, "Whole"))[0].source_names == ("Front", "Back")


def test_vertex_groups_are_merged_by_name(front, back, whole):
    set_weights(front, "chest", np.full(len(front.data.vertices), 0.75))
    for obj, share in ((front, 0.25), (back, 1.0)):
        set_weights(obj, "spine", np.full(len(obj.data.vertices), share))
    report = transfer(front, whole, "vertex_groups")
    assert report["written"]["vertex_groups"] == ["chest", "spine"]
    assert (report["source"], report["others"]) == ("Front", ["Back"])
    before, behind = ahead(whole)
    np.testing.assert_allclose(weight_array(whole, "chest")[before], 0.75, atol=1e-5)
    np.testing.assert_allclose(weight_array(whole, "chest")[behind], 0, atol=1e-5)
    np.testing.assert_allclose(weight_array(whole, "spine")[behind], 1, atol=1e-5)


def test_displayed_uv_maps_are_merged(front, back, whole):
    add_uv_map(front.data, "UVMap")
    add_uv_map(back.data, "Unwrapped")
    transfer(front, whole, "uv_maps")
    assert whole.data.uv_layers.keys() == ["UVMap"]
    faces = np.array([[*polygon.loop_indices] for polygon in whole.data.polygons])
    vertices = np.array([[*polygon.vertices] for polygon in whole.data.polygons])
    clear = np.abs(positions(whole.data)[vertices, 0]).min(axis=1) > 0.1
    expected = positions(whole.data)[vertices[clear], :2] / 4 + 0.5
    assert np.abs(values(whole.data, "UVMap")[faces[clear]] - expected).max() < 0.02


def test_areas_on_objects_without_a_layer_keep_their_data(front, whole):
    add_attribute(front.data, "Paint", "FLOAT_COLOR", "POINT", np.tile([1, 0, 0, 1], (len(front.data.vertices), 1)))
    add_attribute(whole.data, "Paint", "FLOAT_COLOR", "POINT", np.tile([0, 0, 1, 1], (len(whole.data.vertices), 1)))
    set_weights(front, "chest", np.ones(len(front.data.vertices)))
    set_weights(whole, "chest", np.full(len(whole.data.vertices), 0.5))
    report = transfer(front, whole, "color_attributes", "vertex_groups")
    before, behind = ahead(whole)
    np.testing.assert_allclose(values(whole.data, "Paint")[before], [[1, 0, 0, 1]] * before.sum(), atol=1e-5)
    np.testing.assert_allclose(values(whole.data, "Paint")[behind], [[0, 0, 1, 1]] * behind.sum(), atol=1e-5)
    np.testing.assert_allclose(weight_array(whole, "chest")[before], 1, atol=1e-5)
    np.testing.assert_allclose(weight_array(whole, "chest")[behind], 0.5, atol=1e-5)
    assert (
        sum("are on objects without this data ('Back'), and keep their data" in note for note in report["notes"]) == 2
    )


def test_layers_of_equal_name_and_different_type_are_not_mixed(front, back, whole):
    add_attribute(front.data, "Layer", "FLOAT", "POINT", np.ones(len(front.data.vertices)))
    add_attribute(back.data, "Layer", "INT", "POINT", np.full(len(back.data.vertices), 7))
    report = transfer(front, whole, "attributes")
    assert "another type" in report["skipped"]["Layer of 'Back'"]
    before, behind = ahead(whole)
    assert (values(whole.data, "Layer")[before] == 1).all()
    assert (values(whole.data, "Layer")[behind] == 0).all()


def test_materials_of_all_sources_are_used(front, back, whole):
    front.data.materials.append(new_material("Skin"))
    for name in ("Skin", "Cloth"):
        back.data.materials.append(bpy.data.materials.get(name) or new_material(name))
    back.data.polygons.foreach_set("material_index", np.ones(len(back.data.polygons), np.int32))
    transfer(front, whole, "materials")
    for polygon in whole.data.polygons:
        if abs(polygon.center.x) > 0.1:
            expected = "Skin" if polygon.center.x > 0 else "Cloth"
            assert whole.data.materials[polygon.material_index].name == expected


def test_shape_keys_are_merged_by_name(front, back, whole):
    for obj, names in ((front, ("Up", "Fore")), (back, ("Up", "Aft"))):
        obj.shape_key_add(name="Basis")
        for name in names:
            key = obj.shape_key_add(name=name)
            key.points.foreach_set("co", (positions(obj.data) + UP).ravel())
    driver = back.data.shape_keys.key_blocks["Aft"].driver_add("value").driver
    driver.expression = "0.5"
    report = transfer(front, whole, "shape_keys")
    assert report["written"]["shape_keys"] == ["Up", "Fore", "Aft"]
    rest = positions(whole.data)
    before, behind = ahead(whole, 0.2)
    moved = {name: key_shape(whole.data, name) - rest for name in report["written"]["shape_keys"]}
    assert np.abs(moved["Up"][before | behind] - UP).max() < 0.02
    assert np.abs(moved["Fore"][before] - UP).max() < 0.02
    assert np.abs(moved["Fore"][behind]).max() == 0
    assert np.abs(moved["Aft"][behind] - UP).max() < 0.02
    assert np.abs(moved["Aft"][before]).max() == 0
    assert [curve.data_path for curve in whole.data.shape_keys.animation_data.drivers] == ['key_blocks["Aft"].value']


@pytest.mark.slow
def test_keys_arrive_from_sources_with_vertex_adding_modifiers(front, back, whole):
    for obj in (front, back):
        obj.shape_key_add(name="Basis")
        key = obj.shape_key_add(name="Up")
        key.points.foreach_set("co", (positions(obj.data) + UP).ravel())
        obj.modifiers.new("Subdivision", "SUBSURF").levels = 1
    keep_nearest(whole)
    transfer(front, whole, "shape_keys")
    moved = key_shape(whole.data, "Up") - positions(whole.data)
    assert np.abs(moved - UP).mean() < 0.01


def test_marks_and_custom_normals_arrive_from_all(front, back, whole):
    for edge in back.data.edges:
        edge.use_edge_sharp = True
    front.data.normals_split_custom_set_from_vertices([(0, 0, 1)] * len(front.data.vertices))
    report = transfer(front, whole, "edges", "custom_normals")
    assert report["written"]["edges"] == ["sharp edges"]
    assert report["written"]["custom_normals"] == ["custom_normal"]
    normals = np.array([tuple(normal.vector) for normal in whole.data.corner_normals])
    x = positions(whole.data)[[loop.vertex_index for loop in whole.data.loops], 0]
    assert np.abs(normals[x > 0.2] - [0, 0, 1]).max() < 0.05
    assert normals[x < -0.2, 0].mean() < -0.3


def test_operator_transfers_from_all_sources(front, back, whole):
    add_uv_map(back.data, "Unwrapped")
    set_weights(front, "chest", np.ones(len(front.data.vertices)))
    activate(whole)
    assert bpy.ops.zoomout.transfer(own_sources=True) == {"FINISHED"}
    assert whole.vertex_groups.keys() == ["chest"]
    assert whole.data.uv_layers.keys() == ["Unwrapped"]


def test_renamed_source_is_recognised(front, whole):
    set_weights(front, "chest", np.ones(len(front.data.vertices)))
    front.name = "Chest"
    assert transfer(front, whole, "vertex_groups")["others"] == ["Back"]


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (lambda back: back.data.transform(Matrix.Scale(2, 4)), "'Back' was edited since"),
        (lambda back: bpy.data.objects.remove(back), "'Back' in the scene"),
    ],
)
def test_another_source_that_was_edited_or_removed_is_noticed(front, back, whole, edit, sentence):
    set_weights(front, "chest", np.ones(len(front.data.vertices)))
    assert not preflight.stale(bpy.context, whole)
    edit(back)
    bpy.context.view_layer.update()
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match=sentence):
        transfer(front, whole, "vertex_groups")
    assert snapshot_file() == before


def test_previews_and_seam_cuts_include_all_sources(front, back, whole):
    for obj in (front, back):
        add_uv_map(obj.data, "UVMap")
    pair, match = jobs.run(read_stored_match(bpy.context, "Whole"))
    for kind in (preview.PLACES, preview.CHECKER):
        shown = jobs.run(previews.of_match(bpy.context, pair, match, kind))
        assert [overlay.find(one.object_uid).name for one in shown.overlays] == ["Whole", "Front", "Back"]
    assert "Cut 'Whole' along the seams of 'UVMap'" in cut_seams(bpy.context, front, whole)
    assert stored_match.read(whole.data, joined_pair()).others == ("Back",)
