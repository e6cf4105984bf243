# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting a mesh along its source's seams in Blender: exact islands, and all of the mesh's own data is kept."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from scenes import (
    activate,
    add_attribute,
    decimate,
    ellipsoid,
    from_pydata,
    positions,
    set_weights,
    values,
    weight_array,
)
from scipy.spatial import cKDTree
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.seam_cut import cut_seams
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from blender_addon.viewport import overlay, preview


@pytest.fixture
def source():
    """Two islands whose border is close to the plane z = 0."""
    obj = ellipsoid("Source")
    mesh = obj.data
    centres = np.empty(3 * len(mesh.polygons), np.float32)
    mesh.polygons.foreach_get("center", centres)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    upper = np.repeat(centres.reshape(-1, 3)[:, 2] > 0, 3)
    uv = positions(mesh)[corners, :2] / 8 + 0.25 + 0.5 * upper[:, None]
    mesh.uv_layers.new(name="Atlas").data.foreach_set("uv", np.ascontiguousarray(uv, np.float32).ravel())
    return obj


@pytest.fixture
def target(source):
    """The source's shape with fewer triangles at the same place, and its true match."""
    obj = decimate()
    keep_true_match(obj)
    return obj


def test_cut_islands_end_at_the_seam(source, target):
    before = len(target.data.vertices)
    message = cut_seams(bpy.context, source, target)
    assert f"{len(target.data.vertices) - before} vertices and" in message
    assert len(target.data.vertices) > before + 10
    transfer_objects(bpy.context, source, target, ("uv_maps",))
    uv = values(target.data, "Atlas").reshape(-1, 2)
    corners = np.empty(len(target.data.loops), np.int32)
    target.data.loops.foreach_get("vertex_index", corners)
    place = positions(target.data)[corners, :2] / 8 + 0.25
    upper = uv.mean(axis=1) > place.mean(axis=1) + 0.25
    # Cut there, no face reaches over the seam, so every corner has the value of its own place.
    assert np.abs(uv - place - 0.5 * upper[:, None]).max() < 0.01
    height = positions(target.data)[corners, 2]
    reach = 0.02
    assert (height[upper] > -reach).mean() > 0.995
    assert (height[~upper] < reach).mean() > 0.995


def test_preview_shows_uvs_after_cut_without_changing_the_mesh(source, target):
    before = len(target.data.vertices)
    activate(target)
    bpy.ops.zoomout.preview(kind="CUT")
    (coat,) = [each for each in overlay.overlays() if each.object_uid == target.session_uid]
    evaluated = target.evaluated_get(bpy.context.evaluated_depsgraph_get())
    previewed = overlay.visible_surface(coat, target, evaluated)
    assert len(target.data.vertices) == before
    assert len(coat.values) > len(target.data.loops)
    cut_seams(bpy.context, source, target)
    assert preview.preview_of(target).kind == "CHECKER"  # there is nothing to cut any more
    transfer_objects(bpy.context, source, target, ("uv_maps",))
    corners = np.empty(len(target.data.loops), np.int32)
    target.data.loops.foreach_get("vertex_index", corners)
    drawn = cKDTree(np.hstack([previewed["position"], previewed["color"][:, :2]]))
    cut = np.hstack([positions(target.data)[corners], values(target.data, "Atlas").reshape(-1, 2)])
    assert drawn.query(cut)[0].max() < 1e-5


@pytest.mark.parametrize("kind", ["ARRAY", "CAST"])
def test_a_preview_of_a_cut_follows_modifiers_that_keep_the_vertices(target, kind):
    activate(target)
    bpy.ops.zoomout.preview(kind="CUT")
    (coat,) = [each for each in overlay.overlays() if each.object_uid == target.session_uid]
    target.modifiers.new("Modifier", kind)
    evaluated = target.evaluated_get(bpy.context.evaluated_depsgraph_get())
    drawn = overlay.visible_surface(coat, target, evaluated)["position"]
    used = np.unique(drawn.round(4), axis=0)
    expected = positions((target if kind == "ARRAY" else evaluated).data).round(4)
    assert (cKDTree(used).query(expected)[0] < 1e-3).all()


@pytest.mark.parametrize(("angle", "count"), [(45, 16), (0, 16), (45, 100)])
def test_cutting_is_suggested_for_zigzag_borders(angle, count):
    source = plane("Source", 32)
    corners = np.empty(len(source.data.loops), np.int32)
    source.data.loops.foreach_get("vertex_index", corners)
    right = np.repeat(positions(source.data)[corners, 0].reshape(-1, 4).mean(axis=1) > 0, 4)
    uv = positions(source.data)[corners, :2] / 8 + 0.25 + 0.5 * right[:, None]
    source.data.uv_layers.new(name="Atlas").data.foreach_set("uv", np.ascontiguousarray(uv, np.float32).ravel())
    target = plane("Target", count)
    target.data.transform(Matrix.Rotation(np.radians(angle), 4, "Z") @ Matrix.Scale(0.7, 4))
    keep_true_match(target)
    notes = transfer_objects(bpy.context, source, target, ("uv_maps",))["notes"]
    suggestion = (
        "Atlas: UV islands of 'Target' end at its own edges, which zigzag: Cut Along Seams before the transfer makes "
        "their borders exact."
    )
    assert (suggestion in notes) == (angle == 45 and count == 16)


def test_cut_interpolates_mesh_data_and_keeps_the_match(source, target):
    height = positions(target.data)[:, 2].astype(float)
    set_weights(target, "Height", np.clip(height + 0.5, 0, 1))
    add_attribute(target.data, "height", "FLOAT", "POINT", height)
    target.shape_key_add(name="Basis")
    key = target.shape_key_add(name="Up")
    key.value = 0
    key.data.foreach_set("co", (positions(target.data) + np.array([0, 0, 1], np.float32)).ravel())
    cut_seams(bpy.context, source, target)
    now = positions(target.data)[:, 2]
    np.testing.assert_allclose(values(target.data, "height"), now, atol=1e-5)
    np.testing.assert_allclose(weight_array(target, "Height"), np.clip(now + 0.5, 0, 1), atol=1e-4)
    moved = np.empty(3 * len(now), np.float32)
    target.data.shape_keys.key_blocks["Up"].data.foreach_get("co", moved)
    np.testing.assert_allclose(moved.reshape(-1, 3)[:, 2], now + 1, atol=1e-5)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    kept = stored_match.read(target.data, pair)
    images = kept.surface_map.interpolate(pair.source.vertices)
    assert np.linalg.norm(images - pair.target.vertices, axis=1).max() < 0.05


def test_new_vertices_inherit_partners_and_tears(source, target):
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    right = pair.target.vertices[:, 0] > 0
    of_source = pair.source.vertices[:, 0] > 0
    kept = stored_match.read(target.data, pair)
    known = replace(kept, has_partner=right, source_has_partner=of_source, without_partner=(0.5, 0.5), torn=~right)
    stored_match.write(target.data, known, pair, {})
    before = len(target.data.vertices)
    cut_seams(bpy.context, source, target)
    now = stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))
    np.testing.assert_array_equal(now.has_partner[:before], right)
    new, x = now.has_partner[before:], positions(target.data)[before:, 0]
    assert new[x > 0.1].all()
    assert not new[x < 0].any()
    np.testing.assert_array_equal(now.torn, ~now.has_partner)
    np.testing.assert_array_equal(now.source_has_partner, of_source)
    assert tuple(now.without_partner) == (0.5, 0.5)


def plane(name, count):
    """A square from -1 to 1 of count x count quads."""
    places = np.linspace(-1, 1, count + 1)
    x, y = np.meshgrid(places, places)
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    faces = first[:, None] + [0, 1, count + 2, count + 1]
    return from_pydata(name, np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]).tolist(), faces.tolist())


def test_face_is_divided_where_seams_meet():
    # Six islands, whose borders meet at x = -0.5 and at x = 0.5, where the target's faces have their middles about.
    source, target = plane("Source", 8), plane("Target", 5)
    mesh = source.data
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    at = positions(mesh)[corners, :2]
    middle = np.repeat(at.reshape(-1, 4, 2).mean(axis=1), 4, axis=0)
    island = np.column_stack([np.searchsorted([-0.5, 0.5], middle[:, 0]), middle[:, 1] > 0])
    mesh.uv_layers.new(name="Atlas").data.foreach_set("uv", (at + 4 * island).astype(np.float32).ravel())
    keep_true_match(target)
    before = len(target.data.vertices)
    add_attribute(target.data, "slope", "FLOAT", "POINT", positions(target.data) @ [1.0, 2.0, 0.0])
    target.shape_key_add(name="Basis")
    key = target.shape_key_add(name="Up")
    key.value = 0
    key.data.foreach_set("co", (positions(target.data) + np.array([0, 0, 1], np.float32)).ravel())

    cut_seams(bpy.context, source, target)
    place = positions(target.data)
    np.testing.assert_allclose(place[-2:], [[-0.5, 0, 0], [0.5, 0, 0]], atol=1e-6)
    assert len(place) == before + 6 + 2 * 6 + 2  # crossings of the line y = 0, and of two lines across
    np.testing.assert_allclose(values(target.data, "slope"), place @ [1.0, 2.0, 0.0], atol=1e-5)
    moved = np.empty(3 * len(place), np.float32)
    target.data.shape_keys.key_blocks["Up"].data.foreach_get("co", moved)
    np.testing.assert_allclose(moved.reshape(-1, 3), place + np.array([0, 0, 1]), atol=1e-5)
    transfer_objects(bpy.context, source, target, ("uv_maps",))
    corners = np.empty(len(target.data.loops), np.int32)
    target.data.loops.foreach_get("vertex_index", corners)
    sides = values(target.data, "Atlas").reshape(-1, 2) - place[corners, :2]
    np.testing.assert_allclose(sides / 4, np.round(sides / 4), atol=1e-5)
    for face in target.data.polygons:
        assert np.ptp(sides[list(face.loop_indices)], axis=0).max() < 1e-4


def test_without_a_match_or_uvs_nothing_is_cut(source):
    target = decimate()
    faces = len(target.data.polygons)
    with pytest.raises(zo.MeshError, match="was not matched with 'Source' yet: match them first"):
        cut_seams(bpy.context, source, target)
    keep_true_match(target)
    source.data.uv_layers["Atlas"].data.foreach_set("uv", np.full(2 * len(source.data.loops), 0.3, np.float32))
    source.data.update_tag()
    with pytest.raises(zo.MeshError, match="All UVs of 'Atlas' are at one point: unwrap the source"):
        cut_seams(bpy.context, source, target)
    source.data.uv_layers.remove(source.data.uv_layers["Atlas"])
    source.data.update_tag()
    with pytest.raises(zo.MeshError, match="has no UV map"):
        cut_seams(bpy.context, source, target)
    assert len(target.data.polygons) == faces
