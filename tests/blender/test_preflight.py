# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks shown above a button: blocking problems, doubts, and outdated matches."""

import bpy
import numpy as np
import pytest
from scenes import activate, ellipsoid, from_pydata, link, positions
from turns import turns

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.jobs import Job
from blender_addon.mesh_data import content_hash
from blender_addon.scene import mesh_facts
from blender_addon.scene.pair import read_pair
from blender_addon.services import preflight
from blender_addon.services.matching.match import match_objects


def found():
    """The blocking and the non-blocking sentences, once all facts are known."""
    bpy.context.view_layer.update()
    preflight.findings(bpy.context)
    mesh_facts.inspect_now()
    everything = preflight.findings(bpy.context)
    return [one.text for one in everything if one.blocks], [one.text for one in everything if not one.blocks]


def edit_through_another_object(target, source):
    other = link("Other", target.data)
    activate(other)
    bpy.ops.object.mode_set(mode="EDIT")
    other.select_set(False)
    source.select_set(True)
    bpy.context.view_layer.objects.active = target


def test_valid_scene_has_no_findings(target):
    assert found() == ([], [])


@pytest.mark.parametrize(
    ("defect", "sentence"),
    [
        ("no target", "Select the source mesh, then Shift-click the target mesh."),
        ("no target of a source", "Make the target mesh active."),
        ("edited elsewhere", "The active mesh is in Edit Mode through another object: leave Edit Mode there."),
        ("no source", "Select the source mesh, then Shift-click the target mesh."),
        ("many", "2 meshes are selected besides the active one: select only the source, or choose it in the sidebar."),
        ("itself", "'Target' cannot be its own source: choose another source, or make another mesh active."),
        ("one mesh", "'Source' and 'Target' share one mesh: make the target single-user, or choose another source."),
        ("no faces", "'Source' has no faces: choose a mesh with a surface."),
        (
            "screw",
            "The mesh of 'Target' has no faces before its modifiers: apply 'Screw', because data is written to the "
            "mesh itself.",
        ),
    ],
)
def test_blocking_problem_is_reported_alone(source, target, defect, sentence):
    if defect == "no target":
        bpy.context.view_layer.objects.active = None
    elif defect == "no target of a source":
        bpy.context.view_layer.objects.active = None
        bpy.context.scene.zoomout.source = source
    elif defect == "edited elsewhere":
        edit_through_another_object(target, source)
    elif defect == "no source":
        activate(target)
    elif defect == "many":
        activate(target, source, ellipsoid("Other", 2))
    elif defect == "itself":
        bpy.context.scene.zoomout.source = target
    elif defect == "one mesh":
        source.data = target.data
    elif defect == "no faces":
        source.data = bpy.data.meshes.new("Empty")
    else:
        target.data = bpy.data.meshes.new("Stick")
        target.data.from_pydata([(0, 0, 0), (0, 0, 1)], [(0, 1)], [])
        target.modifiers.new("Screw", "SCREW")
    assert found() == ([sentence], [])
    begins = [finding.begins for finding in preflight.findings(bpy.context)]
    assert begins == [defect in ("no target", "no target of a source", "no source")]


@pytest.mark.parametrize("is_chosen", [False, True])
def test_disabled_matched_source_is_reported(source, target, is_chosen):
    match_objects(bpy.context, source, target, k_final=30)
    activate(target)
    bpy.context.scene.zoomout.source = source if is_chosen else None  # Blender may still evaluate it
    source.hide_viewport = True
    bpy.context.view_layer.update()
    sentence = "'Source' or its collection is disabled in the viewport: enable it."
    assert preflight.findings(bpy.context) == [preflight.Finding(sentence, True)]
    with pytest.raises(zo.MeshError, match="disabled in the viewport"):
        match_objects(bpy.context, source, target, k_final=30)


def test_linked_target_is_reported(source, target, tmp_path):
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {target})
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, linked):
        linked.objects = ["Target"]
    bpy.context.scene.collection.objects.link(linked.objects[0])
    activate(linked.objects[0], source)
    assert found() == (["The active mesh is linked from another file: Object > Relations > Make Local."], [])
    assert not bpy.ops.zoomout.match.poll()


def test_parts_of_one_character_suggest_collections(source, target):
    rig = bpy.data.objects.new("Rig", None)
    bpy.context.scene.collection.objects.link(rig)
    other = ellipsoid("Other", 5)
    bpy.context.scene.zoomout.source = source
    activate(target, other)
    assert found() == ([], [])
    for obj in (target, other):
        obj.parent = rig
    assert found() == ([], ["2 targets are parts of 'Rig': match them together for a better result, see Collections."])
    bpy.context.scene.zoomout.initial = "NEAREST"
    assert found() == ([], [])


@pytest.mark.parametrize("defect", ["parts", "crowded", "mirrored", "few", "shared"])
def test_warnings_do_not_block(source, target, defect):
    if defect == "parts":
        eyes = [ellipsoid(name, 2) for name in ("Left Eye", "Right Eye")]
        for place, eye in enumerate(eyes, start=2):
            eye.location.z = place
        bpy.context.view_layer.update()
        activate(target, *eyes)
        bpy.ops.object.join()
        activate(target, source)
        expected = "Loose parts (1 in 'Source', 3 in 'Target') are paired"
    elif defect == "crowded":
        faces = [list(polygon.vertices) for polygon in source.data.polygons]
        source.data = from_pydata("Fin", [*map(tuple, positions(source.data)), (2, 2, 2)],
                                  [*faces, [*faces[0][:2], len(source.data.vertices)]]).data  # fmt: skip
        expected = "'Source' has edges with more than two faces (1)"
    elif defect == "mirrored":
        source.scale.x = -1
        expected = "'Source' has a negative scale, which swaps its sides"
    elif defect == "few":
        source.data = ellipsoid("Coarse", 1).data
        expected = "'Source' has only 12 vertices, too few for automatic matching"
    else:
        ellipsoid("Twin", 2).data = target.data
        expected = "2 objects share the mesh of 'Target'"
    blocking, doubtful = found()
    assert blocking == []
    (sentence,) = doubtful
    assert sentence.startswith(expected)


def test_loose_parts_are_counted_once_both_meshes_are_known(source, target):
    eye = ellipsoid("Eye", 2)
    eye.location.z = 2
    bpy.context.view_layer.update()
    activate(source, eye)
    bpy.ops.object.join()
    activate(target, source)
    bpy.context.view_layer.update()
    mesh_facts.facts(source)
    mesh_facts.inspect_now()
    assert preflight.findings(bpy.context) == []  # the target is not known yet
    _, doubtful = found()
    assert doubtful[0].startswith("Loose parts (2 in 'Source', 1 in 'Target') are paired")
    target.data.vertices[0].co.x += 0.01
    bpy.context.view_layer.update()
    assert mesh_facts.facts(target) is None
    assert [one.text for one in preflight.findings(bpy.context)] == doubtful


def test_vertices_split_at_seams_are_one_part(source):
    """Some exporters give every face its own vertices."""
    points = positions(source.data)[np.array([polygon.vertices for polygon in source.data.polygons])].reshape(-1, 3)
    split = from_pydata("Split", points.tolist(), np.arange(len(points)).reshape(-1, 3).tolist())
    assert mesh_facts.facts(split) is None
    mesh_facts.inspect_now()
    assert mesh_facts.facts(split).parts == 1


def test_facts_are_kept_until_an_edit(target):
    bpy.context.view_layer.update()
    assert mesh_facts.facts(target) is None
    mesh_facts.inspect_now()
    known = mesh_facts.facts(target)
    assert known.content == content_hash(target.data)
    target.location.x = 1
    bpy.context.view_layer.update()
    assert mesh_facts.facts(target) is known
    target.data.vertices[0].co.x += 1
    bpy.context.view_layer.update()
    assert mesh_facts.facts(target) is None
    mesh_facts.inspect_now()
    assert mesh_facts.facts(target).content == content_hash(target.data) != known.content


def test_edit_during_inspection_discards_its_result(target):
    bpy.context.view_layer.update()
    mesh_facts.facts(target)
    looking = turns(Job(mesh_facts._inspections()))
    next(looking)
    target.data.vertices[0].co.x += 1
    bpy.context.view_layer.update()
    for _ in looking:
        pass
    assert mesh_facts.facts(target) is None


@pytest.mark.parametrize("edit", ["target moved", "source moved", "source divided", "target mirrored", "gone"])
def test_outdated_match_is_detected_while_drawing(source, target, edit):
    match_objects(bpy.context, source, target, k_final=30)
    preflight.stale(bpy.context, target)
    mesh_facts.inspect_now()
    assert preflight.stale(bpy.context, target) == ""
    if edit == "target moved":
        target.data.vertices[3].co.x += 0.1
    elif edit == "source moved":
        source.data.vertices[3].co.x += 0.1
    elif edit == "source divided":
        source.data.vertices.add(1)
        source.data.update()
    elif edit == "target mirrored":
        target.scale.x = -1
    else:
        bpy.data.objects.remove(source)
    bpy.context.view_layer.update()
    if edit.endswith("moved"):
        assert preflight.stale(bpy.context, target) == ""  # not yet known
        mesh_facts.inspect_now()
    role = edit.split()[0]
    expected = f"The {role} '{role.title()}' was edited after the match: match again."
    if edit == "gone":
        expected = "Its source 'Source' is not in the scene: choose the source, then match again."
    assert preflight.stale(bpy.context, target) == expected


def test_posing_and_painting_leave_a_match_up_to_date(source, target):
    match_objects(bpy.context, source, target, k_final=30)
    source.location.z = 4
    source.shape_key_add(name="Basis")
    source.shape_key_add(name="Key").data[3].co.z += 2
    source.data.shape_keys.key_blocks["Key"].value = 1
    target.data.attributes.new("paint", "FLOAT", "POINT")
    bpy.context.view_layer.update()
    preflight.stale(bpy.context, target)
    mesh_facts.inspect_now()
    assert preflight.stale(bpy.context, target) == ""
    jobs.run(read_pair(bpy.context, "Source", "Target"))
