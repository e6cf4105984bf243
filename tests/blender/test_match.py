# SPDX-License-Identifier: GPL-3.0-or-later
"""Matching two objects and storing the result."""

import json
from itertools import islice

import bpy
import numpy as np
import pytest
from scenes import (
    activate,
    add_attribute,
    ellipsoid,
    new_material,
    positions,
    set_weights,
    snapshot_file,
    values,
    weight_array,
)
from turns import finish, turns

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.jobs import Job
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.hints import shared_regions
from blender_addon.services.matching.match import match, match_objects
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from zoomout_core.matching.presets import DETAIL

KEPT = {"zoomout_triangle", "zoomout_barycentric", "zoomout_confidence"}


@pytest.fixture
def target(source):
    """The source's shape, rotated, moved and scaled, its vertices in another order."""
    obj = ellipsoid("Target", 4)
    order = np.random.default_rng(0).permutation(len(obj.data.vertices))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    faces = [[int(place[vertex]) for vertex in polygon.vertices] for polygon in obj.data.polygons]
    shuffled = bpy.data.meshes.new("Shuffled")
    shuffled.from_pydata(positions(obj.data)[order].tolist(), [], faces)
    obj.data = shuffled
    add_attribute(shuffled, "truth", "INT", "POINT", order)
    obj.location, obj.rotation_euler, obj.scale = (4, 1, 0), (0.3, 1.2, 2.0), (0.01, 0.01, 0.01)
    bpy.context.view_layer.update()
    return obj


def mapped_positions(source, target):
    """Images of the target's stored match, in the source's own space."""
    corners = positions(source.data)[triangles(source.data)[values(target.data, "zoomout_triangle")]]
    return np.einsum("nc,ncx->nx", values(target.data, "zoomout_barycentric"), corners)


def triangles(mesh):
    mesh.calc_loop_triangles()
    array = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", array)
    return array.reshape(-1, 3)


def test_match_is_accurate_and_stored_on_the_target(source, target):
    activate(target, source)
    assert bpy.ops.zoomout.match() == {"FINISHED"}
    assert set(target.data.attributes.keys()) >= KEPT
    assert {target.data.attributes[name].domain for name in KEPT} == {"POINT"}
    truth = positions(source.data)[values(target.data, "truth")]
    distance = np.linalg.norm(mapped_positions(source, target) - truth, axis=1)
    assert np.mean(distance) < 0.02
    assert values(target.data, "zoomout_confidence").mean() > 0.8
    kept = json.loads(target.data["zoomout_match"])
    assert kept["source"] == "Source"


def test_mirrored_objects_are_matched_to_the_true_points(source, target):
    for obj in (source, target):
        obj.scale.x = -obj.scale.x
    bpy.context.view_layer.update()
    result = match_objects(bpy.context, source, target)
    truth = positions(source.data)[values(target.data, "truth")]
    image = result.surface_map.interpolate(positions(source.data))
    assert np.linalg.norm(image - truth, axis=1).mean() < 0.02


def test_source_is_matched_with_its_modifiers(source, target):
    finer = source.modifiers.new("Finer", "SUBSURF")
    finer.levels, finer.subdivision_type = 1, "SIMPLE"
    result = match_objects(bpy.context, source, target)
    assert len(result.surface_map.source_triangles) == 6 * len(source.data.polygons)
    truth = positions(source.data)[values(target.data, "truth")]
    evaluated = source.evaluated_get(bpy.context.evaluated_depsgraph_get())
    image = result.surface_map.interpolate(positions(evaluated.to_mesh()))
    evaluated.to_mesh_clear()
    # So coarse a mesh has other eigenfunctions than its refinement; a wrong map misses by half the shape.
    assert np.linalg.norm(image - truth, axis=1).mean() < 0.1


def test_stored_match_equals_the_result(source, target):
    result = match_objects(bpy.context, source, target, k_final=40)
    kept = stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))
    np.testing.assert_array_equal(kept.surface_map.triangle, result.surface_map.triangle)
    np.testing.assert_allclose(kept.surface_map.barycentric, result.surface_map.barycentric, atol=1e-6)
    np.testing.assert_allclose(kept.surface_map.barycentric.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(kept.confidence, result.confidence, atol=1e-6)
    assert kept.notes == result.notes


@pytest.mark.slow
def test_sidebar_source_overrides_selection_and_argument_overrides_both(source, target):
    other, third = ellipsoid("Other", 3), ellipsoid("Third", 3)
    activate(target, other)
    bpy.context.scene.zoomout.source = source
    bpy.context.scene.zoomout.k_final = 30
    assert bpy.ops.zoomout.match() == {"FINISHED"}
    assert json.loads(target.data["zoomout_match"])["source"] == "Source"
    assert bpy.ops.zoomout.match(source=third.name) == {"FINISHED"}
    assert json.loads(target.data["zoomout_match"])["source"] == "Third"
    bpy.context.scene.zoomout.source = None
    assert bpy.ops.zoomout.match() == {"FINISHED"}
    assert json.loads(target.data["zoomout_match"])["source"] == "Other"


def test_omitted_options_come_from_the_scene(source, target, monkeypatch):
    seen = []

    def spy(source, target, **options):
        seen.append(options)
        raise zo.MeshError("Enough.")

    monkeypatch.setattr("blender_addon.services.matching.pair_match.zo.match", spy)
    activate(target, source)
    bpy.context.scene.zoomout.k_final = 77
    bpy.context.scene.zoomout.initial = "PROXIMITY"
    for options in ({}, {"k_final": 33}, {}):
        with pytest.raises(RuntimeError, match=r"Enough\."):
            bpy.ops.zoomout.match(**options)
    assert seen == [
        {"initial": "proximity", "k_final": 77},
        {"initial": "proximity", "k_final": 33},
        {"initial": "proximity", "k_final": 77},
    ]


def name_a_region(obj, place, what):
    """Name the part of an ellipsoid around a place, given in the source's position; see the attribute `truth`."""
    rest = positions(bpy.data.objects["Source"].data)
    here = rest if obj.name == "Source" else rest[values(obj.data, "truth")]
    inside = np.linalg.norm(here - place, axis=1) < 0.6
    if what == "MATERIAL":
        obj.data.materials.append(None)
        obj.data.materials.append(bpy.data.materials.get("Skin") or new_material("Skin"))
        faces = [int(inside[list(polygon.vertices)].all()) for polygon in obj.data.polygons]
        obj.data.polygons.foreach_set("material_index", faces)
    else:
        set_weights(obj, what, 0.7 * inside)


def test_shared_names_are_used_as_evidence_and_reported(source, target):
    for obj in (source, target):
        name_a_region(obj, (1, 0, 0), "Nose")
        name_a_region(obj, (-1, 0, 0), "MATERIAL")
        set_weights(obj, "All", np.ones(len(obj.data.vertices)))
        set_weights(obj, "Faint", 0.4 * np.arange(len(obj.data.vertices)) / len(obj.data.vertices))
    name_a_region(source, (0, 0.7, 0), "On the source only")
    source.modifiers.new("Finer", "SUBSURF").subdivision_type = "SIMPLE"
    bpy.context.view_layer.update()
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    regions, _ = jobs.run(shared_regions(bpy.context, pair))
    assert set(regions) == {("vertex group", "Nose"), ("material", "Skin")}
    for (what, _), (of_source, of_target) in regions.items():
        place = (1, 0, 0) if what == "vertex group" else (-1, 0, 0)
        truth = positions(source.data)[values(target.data, "truth")]
        for where in (pair.source.vertices[of_source], truth[of_target]):
            assert len(where) > 10
            assert np.linalg.norm(where - place, axis=1).max() < 0.65
    result = match_objects(bpy.context, source, target, k_final=30)
    assert result.candidates[0].scores["regions"] < 0.4
    assert result.notes[0] == "Hints used: 1 vertex group of the same name, 1 material of the same name."
    assert stored_match.description(target.data)["notes"][0] == result.notes[0]


def test_contradicting_names_are_ignored_and_reported(source, target):
    for obj, sign in ((source, 1), (target, -1)):
        name_a_region(obj, (sign, 0, 0), "Nose")
        name_a_region(obj, (-sign, 0, 0), "Tail")
    result = match_objects(bpy.context, source, target)
    truth = positions(source.data)[values(target.data, "truth")]
    assert np.linalg.norm(mapped_positions(source, target) - truth, axis=1).mean() < 0.02
    assert any("names or sides are swapped" in note for note in result.notes)


@pytest.mark.slow
def test_names_from_an_earlier_transfer_prove_nothing(source, target):
    name_a_region(source, (1, 0, 0), "Nose")
    for obj in (source, target):
        name_a_region(obj, (-1, 0, 0), "MATERIAL")
    transfer_objects(bpy.context, source, target, ["vertex_groups"], k_final=30)
    assert (weight_array(target, "Nose") > 0.5).sum() > 10
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    regions, received = jobs.run(shared_regions(bpy.context, pair))
    assert set(regions) == {("material", "Skin")}
    assert received


def test_up_axis_and_last_match_are_optional_evidence(source, target, monkeypatch):
    for obj in (source, target):
        name_a_region(obj, (1, 0, 0), "Nose")
    last = match_objects(bpy.context, source, target, k_final=30).surface_map
    activate(target, source)
    bpy.context.scene.zoomout.names = False
    assert bpy.ops.zoomout.match(k_final=30, same_up=True, from_last=True) == {"FINISHED"}
    assert stored_match.description(target.data)["notes"][0] == "Hints used: the same up axis, the last match."

    def seen(**options):
        arguments = {}

        def spy(source, target, **given):
            arguments.update(given)
            raise zo.MeshError("Enough.")

        monkeypatch.setattr("blender_addon.services.matching.pair_match.zo.match", spy)
        with pytest.raises(RuntimeError, match=r"Enough\."):
            bpy.ops.zoomout.match(**options)
        return arguments

    assert set(seen()) == {"initial", "upright"}
    assert set(seen(names=True)) == {"initial", "upright", "regions"}
    assert seen(same_up=True)["common_axes"] == (0, 0, 1)
    assert len(seen(from_last=True)["initial_map"].triangle) == len(last.triangle)
    assert set(seen(initial="PROXIMITY", names=True, same_up=True, from_last=True)) == {"initial"}
    assert seen(detail="FINE", k_final=90, upright=False) == {
        "initial": "auto",
        **DETAIL["fine"],
        "k_final": 90,
        "upright": False,
    }
    target.data.vertices[3].co.x += 0.1
    assert "initial_map" not in seen(from_last=True)


@pytest.mark.parametrize("defect", ["no faces", "not finite", "edit mode", "disabled", "same mesh"])
def test_a_failed_match_is_one_sentence_and_leaves_the_scene_untouched(source, target, defect):
    match_objects(bpy.context, source, target, k_final=30)  # an earlier result must survive, too
    activate(target, source)
    if defect == "no faces":
        source.data = bpy.data.meshes.new("Empty")
    elif defect == "not finite":
        target.data.vertices[5].co.x = float("nan")
    elif defect == "edit mode":
        activate(source, target)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.context.view_layer.objects.active = target
    elif defect == "disabled":
        source.hide_viewport = True
    elif defect == "same mesh":
        source.data = target.data
    before = snapshot_file()
    with pytest.raises(zo.MeshError) as error:
        match_objects(bpy.context, source, target)
    sentence = str(error.value)
    assert "\n" not in sentence
    assert sentence.endswith(".")
    assert snapshot_file() == before
    if defect != "edit mode":  # poll says so before
        with pytest.raises(RuntimeError) as report:
            bpy.ops.zoomout.match(source="Source")
        assert str(report.value).strip() == f"Error: {sentence}"
        assert snapshot_file() == before


def test_cancelled_match_changes_nothing(source, target):
    before = snapshot_file()
    for number in range(1, 5):
        job = Job(match(bpy.context, "Source", "Target", k_final=30))
        assert len([*islice(turns(job), number)]) == number
        assert snapshot_file() == before
        job.cancel()
        assert snapshot_file() == before
    finish(Job(match(bpy.context, "Source", "Target", k_final=30)))
    assert snapshot_file() != before


@pytest.mark.parametrize("edit", ["target moved", "source moved", "target gone"])
def test_objects_that_change_during_a_match_are_not_written_to(source, target, edit):
    job = Job(match(bpy.context, "Source", "Target", k_final=30))
    next(turns(job))
    if edit == "target gone":
        bpy.data.objects.remove(target)
    else:
        (target if edit == "target moved" else source).data.vertices[7].co.z += 0.25
        bpy.context.view_layer.update()
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="Target" if edit.startswith("target") else "Source"):
        finish(job)
    assert snapshot_file() == before


def test_a_match_is_recognised_after_renaming_posing_and_painting(source, target):
    match_objects(bpy.context, source, target, k_final=30)
    source.name = "Hero"
    source.location.x += 10
    source.shape_key_add(name="Basis")
    source.shape_key_add(name="Key").data[3].co.z += 2
    source.data.shape_keys.key_blocks["Key"].value = 1
    add_attribute(source.data, "paint", "FLOAT", "POINT", np.ones(len(source.data.vertices)))
    bpy.context.view_layer.update()
    assert stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Hero", "Target"))) is not None


def folding_pose(source):
    """Convert a mesh to quads, and add a shape key of value 0 that folds one of them."""
    activate(source)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.tris_convert_to_quads(face_threshold=3.2, shape_threshold=3.2)
    bpy.ops.object.mode_set(mode="OBJECT")
    quad = next(polygon for polygon in source.data.polygons if len(polygon.vertices) == 4)
    a, _, c, d = (source.data.vertices[i].co for i in quad.vertices)
    folded = 0.5 * d + 0.25 * (a + c)  # the second corner, moved over the diagonal of the first
    source.shape_key_add(name="Basis")
    pose = source.shape_key_add(name="Pose")
    pose.data[quad.vertices[1]].co = folded
    pose.value = 0
    return pose


@pytest.mark.slow
def test_match_with_subdivided_source_survives_folding_pose(source, target):
    pose = folding_pose(source)
    subdivision = source.modifiers.new("Finer", "SUBSURF")
    subdivision.levels, subdivision.subdivision_type = 1, "SIMPLE"
    before = match_objects(bpy.context, source, target, k_final=30).surface_map
    pose.value = 1
    bpy.context.view_layer.update()
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    assert not np.array_equal(pair.source.triangles, before.source_triangles)
    after = stored_match.read(target.data, pair).surface_map
    moved = np.linalg.norm(after.interpolate(pair.source.vertices) - before.interpolate(pair.source.vertices), axis=1)
    assert (moved > 1e-5).mean() < 0.01
    corners = pair.source.vertices[pair.source.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    assert moved.max() < longest


def test_a_match_outlives_a_pose_that_folds_quads(source, target):
    pose = folding_pose(source)
    match_objects(bpy.context, source, target, k_final=30)
    pose.value = 1
    bpy.context.view_layer.update()
    evaluated = source.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert not np.array_equal(triangles(evaluated), triangles(source.data))
    assert stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target"))) is not None


@pytest.mark.parametrize("edited", ["Source", "Target"])
@pytest.mark.parametrize("edit", ["moved", "deleted", "flipped", "mirrored"])
def test_a_match_of_meshes_that_were_edited_since_is_refused(source, target, edited, edit):
    match_objects(bpy.context, source, target, k_final=30)
    obj = bpy.data.objects[edited]
    if edit == "moved":
        obj.data.vertices[3].co.x += 0.1
    elif edit == "mirrored":
        obj.scale.x = -obj.scale.x
    else:
        activate(obj)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_mode(type="FACE")
        bpy.ops.mesh.select_all(action="DESELECT")
        bpy.ops.object.mode_set(mode="OBJECT")
        obj.data.polygons[9].select = True
        bpy.ops.object.mode_set(mode="EDIT")
        if edit == "deleted":
            bpy.ops.mesh.delete(type="FACE")
        else:
            bpy.ops.mesh.flip_normals()
        bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    with pytest.raises(zo.MeshError, match=f"'{edited}' was edited"):
        stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))


def test_a_match_with_another_source_does_not_count(source, target):
    match_objects(bpy.context, source, target, k_final=30)
    ellipsoid("Other", 3)
    assert stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Other", "Target"))) is None


def test_a_target_of_another_file_is_refused(source, target, tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {target})
    bpy.data.objects.remove(target)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Target"]
    library_object = wanted.objects[0]
    bpy.context.scene.collection.objects.link(library_object)
    activate(library_object, source)
    assert not bpy.ops.zoomout.match.poll()
    with pytest.raises(zo.MeshError, match="linked from another file"):
        match_objects(bpy.context, source, library_object)


def test_linked_source_with_the_same_name_is_refused(source, target, tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {source})
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Source"]
    match_objects(bpy.context, source, target, initial="proximity")  # it is in no scene
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    with pytest.raises(zo.MeshError, match="several objects named 'Source'"):
        match_objects(bpy.context, wanted.objects[0], target)
    source.name = "Mine"
    match_objects(bpy.context, wanted.objects[0], target, initial="proximity")


def test_one_match_is_one_undo_step(source, target):
    activate(target, source)
    bpy.ops.ed.undo_push(message="before")
    before = snapshot_file()
    assert bpy.ops.zoomout.match("EXEC_DEFAULT", True, k_final=30) == {"FINISHED"}
    assert snapshot_file() != before
    bpy.ops.ed.undo()
    assert snapshot_file() == before


def test_operator_is_disabled_without_a_target_mesh(source, target):
    activate(target, source)
    assert bpy.ops.zoomout.match.poll()
    empty = bpy.data.objects.new("Empty", None)
    bpy.context.scene.collection.objects.link(empty)
    activate(empty, source)
    assert not bpy.ops.zoomout.match.poll()
