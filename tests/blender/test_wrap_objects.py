# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrapping objects: as a key, as the mesh itself, as a new object, and the other way round."""

from functools import partial
from itertools import islice
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from drawing import Layout
from mathutils import Euler, Matrix
from scenes import (
    activate,
    ellipsoid,
    key_shape,
    positions,
    set_weights,
    snapshot,
    snapshot_file,
    visible_positions,
)
from scipy.spatial import cKDTree
from turns import turns

import zoomout_core as zo
from blender_addon import api, jobs
from blender_addon.operators.wrap import ZOOMOUT_OT_wrap
from blender_addon.properties.wrap import WrapOptions
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.made_match import MatchUse
from blender_addon.services.wrap import prepare_wrap, summary
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.transfer.wrapping.subdivision import limit_points

PLACE = Matrix.LocRotScale((3, -1, 2), Euler((0.5, 0, 0.3)), (2, 2, 2))


@pytest.fixture
def source():
    """An ellipsoid with a bump, moved and twice as large."""
    obj = ellipsoid("Source", 4)
    obj.matrix_world = PLACE
    bpy.context.view_layer.update()
    return obj


@pytest.fixture
def target(source):
    """A sphere with other triangles, matched by directions."""
    obj = ellipsoid("Target", 3, (1.0, 1.0, 1.0))
    points = positions(obj.data)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    obj.data.vertices.foreach_set("co", points.ravel())
    obj.data.update()
    bpy.context.view_layer.update()
    keep_match_by_direction(obj)
    activate(obj, source)
    return obj


def keep_match_by_direction(target, has_partner=None):
    pair = jobs.run(read_pair(bpy.context, "Source", target.name))
    inverse = np.array(PLACE.inverted())
    around = pair.source.vertices @ inverse[:3, :3].T + inverse[:3, 3]
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    own = positions(target.data).astype(float)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    found = zo.SurfaceMap(*closest_points(own, around, pair.source.triangles), pair.source.triangles)
    match = stored_match.StoredMatch(found, np.ones(len(own)), (), has_partner=has_partner)
    stored_match.write(target.data, match, pair, {})


def off(points, obj):
    """(n,) distances of points from an evaluated object, relative to its extent."""
    triangles = np.array([list(face.vertices) for face in obj.data.polygons])
    vertices = visible_positions(obj).astype(float)
    triangle, weights = closest_points(points.astype(float), vertices, triangles)
    feet = np.einsum("nc,ncx->nx", weights, vertices[triangles[triangle]])
    return np.linalg.norm(points - feet, axis=1) / np.ptp(vertices, axis=0).max()


def moved_to(obj, other):
    """(n, 3) evaluated positions of an object, moved to the origin of another one."""
    return visible_positions(obj) + np.array(other.matrix_world.translation - obj.matrix_world.translation)


def test_wrap_key_has_the_shape_of_the_source(source, target):
    target.matrix_world = Matrix.LocRotScale((0, 5, 0), Euler((0, 1, 0)), (1, 0.5, 1))
    bpy.context.view_layer.update()
    before, basis = snapshot(source), positions(target.data)
    report = api.wrap(bpy.context, source, target)
    assert report["key"] == report["shape"] == "Source"
    assert report["object"] == report["wrapped"] == "Target"
    assert report["turned_over"] == 0
    assert off(moved_to(target, source), source).max() < 1e-5
    np.testing.assert_array_equal(key_shape(target.data, "Basis"), basis)
    assert snapshot(source) == before
    # The match does not change.
    assert api.transfer_objects(bpy.context, source, target, ["attributes"])["vertices"] == len(basis)


def test_wrapping_again_ignores_the_shown_key(source, target):
    api.wrap(bpy.context, source, target)
    first = key_shape(target.data, "Source")
    api.set_landmark(bpy.context, source, 1, 20)
    api.set_landmark(bpy.context, target, 1, 30)
    target.data.shape_keys.key_blocks["Source"].value = 0
    bpy.context.view_layer.update()
    api.wrap(bpy.context, source, target)
    hidden = key_shape(target.data, "Source")
    assert np.abs(hidden - first).max() > 0.01
    api.wrap(bpy.context, source, target)
    np.testing.assert_allclose(key_shape(target.data, "Source"), hidden, atol=1e-4)
    assert len(target.data.shape_keys.key_blocks) == 2


def test_wrapping_the_mesh_moves_its_keys_and_match(source, target):
    target.shape_key_add(name="Basis")
    up = target.shape_key_add(name="Up")
    up.value = 0
    up.data.foreach_set("co", (positions(target.data) + np.array([0, 0, 1], np.float32)).ravel())
    report = api.wrap(bpy.context, source, target, api.Wrapping("mesh"))
    assert not report["key"]
    assert off(moved_to(target, source), source).max() < 1e-5
    np.testing.assert_allclose(key_shape(target.data, "Up"), positions(target.data) + np.array([0, 0, 1]), atol=1e-5)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    kept = stored_match.read(target.data, pair)
    assert np.linalg.norm(kept.surface_map.interpolate(pair.source.vertices)
                          - moved_to(target, source), axis=1).mean() < 0.2  # fmt: skip


def test_a_new_object_lies_on_the_source(source, target):
    target.matrix_world = Matrix.Diagonal((-1, 1, 1, 1))  # mirrored, so that its faces are flipped
    bpy.context.view_layer.update()
    keep_match_by_direction(target)
    set_weights(target, "Bone", np.ones(len(target.data.vertices)))
    target.modifiers.new("Cast", "CAST").factor = 0
    before = snapshot(target)
    report = api.wrap(bpy.context, source, target, api.Wrapping("object"))
    made = bpy.data.objects[report["object"]]
    assert made.name == "Target on Source"
    assert off(visible_positions(made), source).max() < 1e-5
    assert [group.name for group in made.vertex_groups] == ["Bone"]
    assert not made.modifiers
    assert made.data.shape_keys is None
    assert snapshot(target) == before
    assert stored_match.read(made.data, jobs.run(read_pair(bpy.context, "Source", made.name))) is not None
    normals = np.array([polygon.normal for polygon in made.data.polygons])
    middles = np.array([polygon.center for polygon in made.data.polygons])
    assert (np.einsum("nx,nx->n", normals, middles) < 0).mean() in (0, 1)


@pytest.mark.parametrize("result", ["shape_key", "mesh", "object"])
def test_the_source_can_be_wrapped_onto_the_target(source, target, result):
    before = snapshot(target)
    report = api.wrap(bpy.context, source, target, api.Wrapping(result, reverse=True))
    assert report["wrapped"] == "Source"
    made = bpy.data.objects[report["object"]]
    assert made.name == ("Source on Target" if result == "object" else "Source")
    assert off(moved_to(made, target), target).max() < 1e-5
    if result == "mesh":  # the match is known to hold for the new shape
        assert stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target"))) is not None
    else:
        assert snapshot(target) == before


def test_shape_outside_the_mask_is_kept(source, target):
    points = positions(target.data)
    set_weights(target, "Top", points[:, 2] > 0)
    api.wrap(bpy.context, source, target, api.Wrapping("mesh", mask="Top"))
    distance = off(moved_to(target, source), source)
    assert distance[points[:, 2] > 0.05].max() < 1e-4
    assert distance[points[:, 2] < -0.6].min() > 0.01


def test_landmarks_are_met_unless_they_are_not_wanted(source, target):
    api.set_landmark(bpy.context, source, 1, 20)
    api.set_landmark(bpy.context, target, 1, 30)
    where = np.array(source.matrix_world @ source.data.vertices[20].co)
    api.wrap(bpy.context, source, target)
    assert np.abs(moved_to(target, source)[30] - where).max() < 1e-4
    api.wrap(bpy.context, source, target, api.Wrapping(landmarks=False))
    assert np.abs(moved_to(target, source)[30] - where).max() > 0.1
    target.data.shape_keys.key_blocks["Source"].value = 0
    bpy.context.view_layer.update()
    api.wrap(bpy.context, source, target, api.Wrapping("object", reverse=True))
    there = visible_positions(target)[30]
    assert np.abs(visible_positions(bpy.data.objects["Source on Target"])[20] - there).max() < 1e-4


@pytest.mark.parametrize("result", ["shape_key", "object"])
def test_subdivided_surface_lies_on_the_source(source, target, result):
    target.modifiers.new("Subdivision", "SUBSURF").levels = 2
    bpy.context.view_layer.update()

    told = []

    def missed(**wrapping):
        report = api.wrap(bpy.context, source, target, api.Wrapping(result, **wrapping))
        told.append(any("also deform its new shape" in note for note in report["notes"]))
        return off(moved_to(bpy.data.objects[report["object"]], source), source)

    cage = missed(subdivided=False)
    through = missed()
    assert len(cage) > 2000
    assert through.mean() < 0.25 * cage.mean()
    assert np.percentile(through, 90) < 0.003
    target.modifiers.new("Cast", "CAST").factor = 0  # no longer the last one
    np.testing.assert_allclose(missed(), cage, atol=1e-4)
    assert told == [each and result == "shape_key" for each in (True, False, True)]


def test_limit_surface_equals_that_of_the_modifier(target):
    surface = jobs.run(read_pair(bpy.context, "Source", "Target")).target
    target.modifiers.new("Subdivision", "SUBSURF").levels = 1
    wanted = cKDTree(visible_positions(target))
    assert wanted.query(limit_points(surface).limit @ surface.vertices)[0].max() < 1e-5


def test_vertices_without_partner_are_reported(source, target):
    alone = positions(target.data)[:, 2] > 0.8
    keep_match_by_direction(target, ~alone)
    report = api.wrap(bpy.context, source, target)
    assert f"{alone.sum()} vertices without a partner" in report["notes"][0]
    assert summary(report).startswith("Wrapped 'Target' onto 'Source' (key 'Source'). ")


def test_the_operator_takes_the_settings_of_the_scene(source, target):
    settings = bpy.context.scene.zoomout
    settings.wrap_result, settings.wrap_detail = "OBJECT", 0.0
    assert bpy.ops.zoomout.wrap() == {"FINISHED"}
    made = bpy.data.objects["Target on Source"]
    assert 1e-4 < off(visible_positions(made), source).mean() < 0.05
    settings.wrap_result, settings.wrap_detail = "SHAPE_KEY", 1.0
    assert bpy.ops.zoomout.wrap(wrap_smoothness=0.9) == {"FINISHED"}
    assert target.data.shape_keys is not None


def test_one_wrap_is_one_undo_step(source, target):
    bpy.ops.ed.undo_push(message="Before")
    before = snapshot_file()
    assert bpy.ops.zoomout.wrap("EXEC_DEFAULT", True) == {"FINISHED"}
    assert snapshot_file() != before
    bpy.ops.ed.undo()
    assert snapshot_file() == before


def test_a_target_that_was_not_matched_yet_is_matched_first(source):
    copy = ellipsoid("Copy", 4)
    activate(copy, source)
    assert bpy.ops.zoomout.wrap(initial="SAME_ORDER") == {"FINISHED"}
    assert stored_match.description(copy.data)["source"] == "Source"
    assert off(moved_to(copy, source), source).max() < 1e-5


def test_adjusting_reuses_the_computed_match(source, monkeypatch):
    copy = ellipsoid("Copy", 4)
    prepare = partial(prepare_wrap, bpy.context, "Source", "Copy", initial="same_order")
    jobs.run(prepare(api.Wrapping()))  # as if it had been undone
    monkeypatch.setattr("blender_addon.services.matching.made_match.match_pair", None)
    jobs.run(prepare(api.Wrapping(detail=0.5), MatchUse(adjusted=True)))()
    assert copy.data.shape_keys is not None


def test_redo_panel_shows_only_adjustable_settings():
    everything, rna = [], bpy.ops.zoomout.wrap.get_rna_type()
    ZOOMOUT_OT_wrap.draw(SimpleNamespace(layout=Layout(everything), bl_rna=rna), bpy.context)
    assert [name for _, name, _ in everything] == list(WrapOptions.__annotations__)


def test_cancelled_wrap_changes_nothing(source, target):
    before = snapshot_file()
    job = jobs.Job(prepare_wrap(bpy.context, "Source", "Target", api.Wrapping()))
    fractions = []
    for progress in turns(job):
        fractions.append(progress.fraction)
        assert snapshot_file() == before
    assert fractions == sorted(fractions)
    job = jobs.Job(prepare_wrap(bpy.context, "Source", "Target", api.Wrapping()))
    assert len([*islice(turns(job), len(fractions))]) == len(fractions)
    job.cancel()
    assert snapshot_file() == before


def refused(source, target, match, **wrapping):
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match=match):
        api.wrap(bpy.context, source, target, api.Wrapping(**wrapping))
    assert snapshot_file() == before


def test_invalid_objects_are_refused_in_one_sentence(source, target):
    refused(source, target, "no vertex group 'Nothing'", mask="Nothing")
    target.vertex_groups.new(name="Empty")
    refused(source, target, "'Empty' of 'Target' is empty", mask="Empty")
    source.modifiers.new("Subdivision", "SUBSURF")
    bpy.context.view_layer.update()
    keep_match_by_direction(target)
    refused(source, target, "change its faces", reverse=True)
    source.modifiers.clear()
    target.scale = (1, 0, 1)
    bpy.context.view_layer.update()
    refused(source, target, "scale of zero")
    activate(target, ellipsoid("Third", 3))
    bpy.context.scene.zoomout.source = source
    with pytest.raises(RuntimeError, match="one target"):
        bpy.ops.zoomout.wrap(wrap_reverse=True)


def test_data_of_other_files_is_refused(source, target, tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {source, target})
    for obj in (source, target):
        bpy.data.meshes.remove(obj.data)
    with bpy.data.libraries.load(path, link=True) as (_, to):
        to.objects = ["Source", "Target"]
    for obj in to.objects:
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    linked_source, linked_target = to.objects
    refused(linked_source, linked_target, "linked from another file")
    own = ellipsoid("Own", 3)
    pair = jobs.run(read_pair(bpy.context, "Source", "Own"))
    found = closest_points(pair.target.vertices, pair.source.vertices, pair.source.triangles)
    match = stored_match.StoredMatch(zo.SurfaceMap(*found, pair.source.triangles), np.ones(len(found[0])), ())
    stored_match.write(own.data, match, pair, {})
    refused(linked_source, own, "linked from another file", reverse=True)
