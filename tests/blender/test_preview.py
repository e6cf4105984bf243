# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours over the objects show a match without changing the file."""

import bpy
import numpy as np
import pytest
from scenes import activate, add_uv_map, ellipsoid, positions, snapshot_file, values
from turns import turns

import blender_addon
import zoomout_core as zo
from blender_addon import jobs, watch
from blender_addon.scene import mesh_facts
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching import previews
from blender_addon.services.matching.match import match_objects
from blender_addon.services.matching.use_candidate import use_candidate_async
from blender_addon.storage import stored_match
from blender_addon.viewport import overlay, preview
from zoomout_core.colors import confidence_colors, place_colors


@pytest.fixture
def source():
    obj = ellipsoid("Source", 4)
    add_uv_map(obj.data, "UVMap")
    return obj


@pytest.fixture
def target(source):
    """A copy of the mesh, with the true match."""
    obj = ellipsoid("Target", 4)
    obj.location.x = 3
    bpy.context.view_layer.update()
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    vertex = np.arange(len(pair.target.vertices))
    match = stored_match.StoredMatch(
        zo.SurfaceMap.from_vertices(vertex, pair.source), np.linspace(0, 1, len(vertex)), ()
    )
    stored_match.write(obj.data, match, pair, {})
    activate(obj, source)
    return obj


def shown():
    return {overlay.find(one.object_uid).name: one.values for one in overlay.overlays()}


def test_confidence_is_seen_on_the_target(target):
    assert bpy.ops.zoomout.preview(kind="CONFIDENCE") == {"FINISHED"}
    assert set(shown()) == {"Target"}
    colors = shown()["Target"]
    np.testing.assert_allclose(colors, confidence_colors(values(target.data, "zoomout_confidence")), atol=1e-6)
    assert colors[0, 0] > 2 * colors[0, 2]  # red without confidence
    assert colors[-1, 2] > 2 * colors[-1, 0]  # blue with


def test_new_match_is_shown_until_the_selection_changes(source, target):
    target.data.attributes.remove(target.data.attributes["zoomout_triangle"])
    assert bpy.ops.zoomout.match(k_final=30) == {"FINISHED"}
    bpy.context.view_layer.update()
    assert preview.preview_of(target).kind == "PLACES"
    assert set(shown()) == {"Source", "Target"}
    watch._after_update(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    assert preview.current() is not None
    activate(source)
    watch._after_update(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    assert preview.current() is None


@pytest.mark.parametrize("kind", ["PLACES", "CHECKER"])
def test_a_transfer_ends_a_preview_that_would_hide_its_result(target, kind):
    assert bpy.ops.zoomout.preview(kind=kind) == {"FINISHED"}
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    assert preview.current() is None


def test_requested_preview_stays_when_selection_changes(source, target):
    for asked in (False, True):
        preview.clear()
        activate(target, source)
        assert bpy.ops.zoomout.match(k_final=30) == {"FINISHED"}
        if asked:
            assert bpy.ops.zoomout.preview(kind="PLACES") == {"FINISHED"}
        activate(source)
        watch._after_update(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
        assert (preview.current() is not None) == asked
    # A match by a script shows nothing.
    preview.clear()
    match_objects(bpy.context, source, target, k_final=30)
    assert preview.current() is None


def test_collapsed_uvs_are_reported(source, target):
    layer = source.data.uv_layers["UVMap"]
    layer.data.foreach_set("uv", np.full(2 * len(source.data.loops), 0.3))
    for kind in ("CHECKER", "CUT"):
        with pytest.raises(RuntimeError, match="All UVs of 'UVMap' are at one point: unwrap the source"):
            bpy.ops.zoomout.preview(kind=kind)
    assert preview.current() is None


def test_a_caption_names_the_preview_until_it_is_hidden(target):
    assert preview.caption() == ()
    assert bpy.ops.zoomout.preview(kind="CONFIDENCE") == {"FINISHED"}
    assert preview.caption() == (
        "Confidence: the X in the tab ZoomOut hides the colors",
        "Blue: certain. Red: doubtful. Violet: no partner",
    )
    assert bpy.ops.zoomout.clear_preview() == {"FINISHED"}
    assert preview.caption() == ()


def test_matching_places_have_equal_colours(source, target):
    assert bpy.ops.zoomout.preview(kind="PLACES") == {"FINISHED"}
    np.testing.assert_allclose(shown()["Target"], shown()["Source"], atol=1e-5)
    low, high = shown()["Source"].min(axis=0), shown()["Source"].max(axis=0)
    np.testing.assert_allclose(high - low, 0.9, atol=1e-3)


def test_checker_follows_the_source_uvs(source, target):
    assert bpy.ops.zoomout.preview(kind="CHECKER") == {"FINISHED"}
    uv = values(source.data, "UVMap")
    np.testing.assert_allclose(shown()["Source"], uv, atol=1e-6)
    np.testing.assert_allclose(shown()["Target"], uv, atol=1e-3)
    source.data.uv_layers.remove(source.data.uv_layers[0])
    source.data.update()
    with pytest.raises(RuntimeError, match="'Source' has no UV map"):
        bpy.ops.zoomout.preview(kind="CHECKER")


def test_previews_do_not_change_the_file(source, target):
    before = snapshot_file()
    for kind in ("CONFIDENCE", "PLACES", "CHECKER"):
        assert bpy.ops.zoomout.preview(kind=kind) == {"FINISHED"}
        assert preview.preview_of(target).kind == kind
        assert preview.preview_of(source) is None
        assert snapshot_file() == before
    assert bpy.ops.zoomout.clear_preview() == {"FINISHED"}
    assert (snapshot_file(), shown(), preview.preview_of(target)) == (before, {}, None)
    with pytest.raises(RuntimeError, match="There is no preview"):
        bpy.ops.zoomout.clear_preview()


def test_new_matches_and_candidates_update_the_preview(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    result = match_objects(bpy.context, source, target, k_final=40)
    around = jobs.run(read_pair(bpy.context, "Source", "Target")).source.vertices
    colors = place_colors(around, around)
    np.testing.assert_allclose(shown()["Target"], result.surface_map.interpolate(colors))
    other = jobs.run(use_candidate_async(bpy.context, target.name, 1))
    np.testing.assert_allclose(shown()["Target"], other.surface_map.interpolate(colors))
    assert np.abs(other.surface_map.interpolate(colors) - result.surface_map.interpolate(colors)).max() > 0.3


def test_a_match_of_other_objects_does_not_show_itself(source, target):
    match_objects(bpy.context, source, target, k_final=40)
    assert shown() == {}


@pytest.mark.parametrize("what", ["target", "source"])
def test_edited_mesh_has_no_preview(source, target, what):
    bpy.data.objects[what.title()].data.vertices[2].co.z += 0.1
    with pytest.raises(RuntimeError, match=f"'{what.title()}' was edited since it was matched: match again"):
        bpy.ops.zoomout.preview(kind="PLACES")
    assert shown() == {}


def test_preview_requires_a_match(source):
    activate(source)
    with pytest.raises(RuntimeError, match="'Source' was not matched yet: match it first"):
        bpy.ops.zoomout.preview(kind="PLACES")


def test_renamed_source_is_found_if_chosen(source, target):
    source.name = "Hero"
    assert bpy.ops.zoomout.preview(kind="PLACES") == {"FINISHED"}
    assert set(shown()) == {"Target", "Hero"}


def handlers():
    """The number of the extension's handlers for each event."""
    return {name: getattr(bpy.app.handlers, name).count(handler) for name, handler in watch.HANDLERS}


def test_a_preview_ends_with_its_file_and_with_the_extension(target):
    bpy.ops.zoomout.preview(kind="PLACES")
    bpy.ops.wm.read_homefile(use_empty=True)
    assert (overlay.overlays(), preview.current(), overlay._handler) == ((), None, None)
    overlay.show((overlay.Overlay(1, np.zeros((3, 3)), ""),))
    assert set(handlers().values()) == {1}
    assert overlay._handler is not None
    blender_addon.unregister()
    assert (overlay.overlays(), overlay._handler) == ((), None)
    assert set(handlers().values()) == {0}
    blender_addon.register()  # as the fixture expects it


def test_overlay_follows_its_object_when_renamed_or_removed(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    target.name = "Renamed"
    source.name = "Target"  # a name that was another's
    assert set(shown()) == {"Renamed", "Target"}
    assert preview.preview_of(target).kind == "PLACES"
    (one, _), uid = overlay.overlays(), target.session_uid
    bpy.data.objects.remove(target)
    assert overlay.find(uid) is None
    assert one.object_uid == uid


def visible():
    """The names of the objects with visible coats, after their meshes have been checked."""
    bpy.context.view_layer.update()
    overlay.visible()
    mesh_facts.inspect_now()
    return {obj.name for _, obj in overlay.visible()}


def test_overlays_are_hidden_while_a_mesh_differs(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    assert visible() == {"Target", "Source"}
    for edited in (target, source):
        edited.data.vertices[3].co.x += 0.5
        assert visible() == set()
        edited.data.vertices[3].co.x -= 0.5
        assert visible() == {"Target", "Source"}
    target.location.x += 1
    target.modifiers.new("Bend", "SIMPLE_DEFORM")
    assert visible() == {"Target", "Source"}


def test_mesh_in_another_mode_has_no_overlay(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    activate(target)  # alone
    for mode in ("EDIT", "SCULPT", "WEIGHT_PAINT"):
        bpy.ops.object.mode_set(mode=mode)
        assert visible() == {"Source"}
        bpy.ops.object.mode_set(mode="OBJECT")
    assert visible() == {"Target", "Source"}


def test_other_candidate_is_previewed_roughly_until_computed(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    match_objects(bpy.context, source, target, k_final=40)
    before = preview.preview_of(target)
    job = jobs.Job(use_candidate_async(bpy.context, "Target", 1))
    next(turns(job))
    rough = shown()["Target"]
    job.cancel()
    assert preview.preview_of(target) is before
    jobs.run(use_candidate_async(bpy.context, "Target", 1))
    final = shown()["Target"]
    assert np.abs(rough - final).mean() < 0.05
    assert np.abs(before.overlays[0].values - final).mean() > 0.1
    bpy.ops.zoomout.preview(kind="CONFIDENCE")
    job = jobs.Job(use_candidate_async(bpy.context, "Target", 0))
    next(turns(job))
    assert preview.preview_of(target).kind == "CONFIDENCE"
    job.cancel()


def test_undo_and_redo_update_the_preview(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    match_objects(bpy.context, source, target, k_final=40)
    bpy.ops.ed.undo_push(message="Matched")
    before = shown()["Target"]
    jobs.run(use_candidate_async(bpy.context, target.name, 1))
    bpy.ops.ed.undo_push(message="Candidate")
    other = shown()["Target"]
    bpy.ops.ed.undo()
    np.testing.assert_allclose(shown()["Target"], before, atol=1e-5)
    bpy.ops.ed.redo()
    np.testing.assert_allclose(shown()["Target"], other, atol=1e-5)


def test_restored_object_regains_its_colours(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    bpy.ops.ed.undo_push(message="Before")
    bpy.data.objects.remove(target)
    bpy.ops.ed.undo_push(message="Deleted")
    assert overlay.find(overlay.overlays()[0].object_uid) is None
    bpy.ops.ed.undo()
    assert set(shown()) == {"Target", "Source"}


def test_removed_match_ends_its_preview(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    bpy.ops.ed.undo_push(message="Matched")
    target.data.attributes.remove(target.data.attributes["zoomout_triangle"])
    bpy.ops.ed.undo_push(message="Removed")
    previews.follow_undo(bpy.context, preview.current())
    assert preview.current() is None


def test_overlay_draws_the_mesh_after_modifiers(source):
    source.modifiers.new("Finer", "SUBSURF").subdivision_type = "SIMPLE"
    bpy.context.view_layer.update()
    mesh = source.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    colors = np.random.default_rng(0).random((len(mesh.vertices), 3))
    surface = overlay.surface_of(mesh, overlay.Overlay(1, colors, ""))
    np.testing.assert_allclose(surface["position"], positions(mesh))
    np.testing.assert_allclose(surface["color"], colors, atol=1e-6)
    corners = surface["position"][surface["triangles"]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(sum(polygon.area for polygon in mesh.polygons), rel=1e-4)
    uv = np.random.default_rng(0).random((len(mesh.loops), 2))
    by_corner = overlay.surface_of(mesh, overlay.Overlay(1, uv, ""))
    np.testing.assert_allclose(by_corner["position"][by_corner["triangles"]], corners)
    np.testing.assert_allclose(by_corner["color"][:, :2], uv, atol=1e-6)
    assert overlay.surface_of(source.data, overlay.Overlay(1, colors, "")) is None  # another mesh


def test_overlay_is_redrawn_when_its_object_moves(source, target):
    bpy.ops.zoomout.preview(kind="PLACES")
    overlay._batches.update({target.session_uid: "drawn", source.session_uid: "drawn"})
    key = source.shape_key_add(name="Basis") and source.shape_key_add(name="Key")
    key.value = 1
    bpy.context.view_layer.update()
    assert set(overlay._batches) == {target.session_uid}
