# SPDX-License-Identifier: GPL-3.0-or-later
"""Modifiers added to a source after matching: the match still refers to the source's own mesh."""

import bpy
import numpy as np
import pytest
from scenes import add_uv_map, set_weights, snapshot_file, values, weight_array
from test_target_modifiers import add_modifier

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.stored_pair import read_stored_match
from blender_addon.services import preflight
from blender_addon.services.matching.match import match_objects
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match

DATA = ("uv_maps", "vertex_groups", "shape_keys", "attributes")
NEAREST = {"initial": "nearest"}


@pytest.fixture
def dressed(source):
    """The source with data of several kinds, deformed by a modifier."""
    count = len(source.data.vertices)
    set_weights(source, "Bone", np.linspace(0.1, 1, count))
    add_uv_map(source.data, "UVMap")
    source.shape_key_add(name="Basis")
    source.shape_key_add(name="Long").data[3].co.z += 0.5
    source.modifiers.new("Cast", "CAST").factor = 0.2
    bpy.context.view_layer.update()
    return source


def received(target):
    """The target's data as arrays."""
    keys = [point.co[:] for point in target.data.shape_keys.key_blocks["Long"].points]
    return weight_array(target, "Bone"), values(target.data, "UVMap"), np.array(keys)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["SUBSURF", "MULTIRES", "MIRROR", "SOLIDIFY", "TRIANGULATE", "DECIMATE", "NODES"])
def test_modifier_added_to_source_keeps_match_and_data(dressed, target, kind):
    match_objects(bpy.context, dressed, target, **NEAREST)
    transfer_objects(bpy.context, dressed, target, DATA)
    before, described = received(target), stored_match.description(target.data)
    add_modifier(dressed, kind)
    bpy.context.view_layer.update()
    assert preflight.stale(bpy.context, target) == ""
    scene = snapshot_file()[1]["Source"]
    report = transfer_objects(bpy.context, dressed, target, DATA)
    assert report["skipped"].keys() <= {"multires displacement"}
    assert stored_match.description(target.data) == described
    assert snapshot_file()[1]["Source"] == scene
    for now, then in zip(received(target), before, strict=True):
        np.testing.assert_allclose(now, then, atol=1e-6)


def test_matched_surface_is_read_despite_new_modifiers(dressed, target):
    match = match_objects(bpy.context, dressed, target, **NEAREST)
    images = match.surface_map.interpolate(jobs.run(read_stored_match(bpy.context, "Target"))[0].source.vertices)
    add_modifier(dressed, "SUBSURF")
    bpy.context.view_layer.update()
    pair, stored = jobs.run(read_stored_match(bpy.context, "Target"))
    np.testing.assert_allclose(stored.surface_map.interpolate(pair.source.vertices), images, atol=1e-6)


def test_previews_and_cuts_work_with_new_source_modifiers(dressed, target):
    match_objects(bpy.context, dressed, target, **NEAREST)
    add_modifier(dressed, "SUBSURF")
    for kind in ("PLACES", "CHECKER", "CONFIDENCE"):
        assert bpy.ops.zoomout.preview(kind=kind) == {"FINISHED"}
    assert bpy.ops.zoomout.cut_seams(source="Source") == {"FINISHED"}
    assert jobs.run(read_stored_match(bpy.context, "Target"))[0].source_fingerprints[0].at_base


def test_a_source_that_was_renamed_may_get_a_modifier(dressed, target):
    match_objects(bpy.context, dressed, target, **NEAREST)
    described = stored_match.description(target.data)
    dressed.name = "Renamed"
    add_modifier(dressed, "SUBSURF")
    bpy.context.view_layer.update()
    transfer_objects(bpy.context, dressed, target, ("vertex_groups",))
    assert stored_match.description(target.data) == described


def test_match_with_modifiers_is_outdated_without_them(dressed, target):
    modifier = add_modifier(dressed, "SUBSURF")
    match_objects(bpy.context, dressed, target, **NEAREST)
    dressed.modifiers.remove(modifier)
    bpy.context.view_layer.update()
    assert "'Source' was edited after" in preflight.stale(bpy.context, target)
    with pytest.raises(zo.MeshError, match="edited since"):
        transfer_objects(bpy.context, dressed, target, DATA)


def test_an_edit_of_the_source_is_noticed_under_its_modifiers(dressed, target):
    match_objects(bpy.context, dressed, target, **NEAREST)
    add_modifier(dressed, "SUBSURF")
    dressed.data.vertices[5].co.z += 0.1
    dressed.data.shape_keys.key_blocks[0].data[5].co.z += 0.1
    with pytest.raises(zo.MeshError, match="edited since"):
        transfer_objects(bpy.context, dressed, target, DATA)
