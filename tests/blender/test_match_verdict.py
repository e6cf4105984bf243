# SPDX-License-Identifier: GPL-3.0-or-later
"""The verdict on a match: it is stored, reported, and stops a transfer along a map that is probably wrong."""

import json
from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from scenes import activate, add_uv_map, ellipsoid, link, new_material, snapshot
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import api, cli, jobs
from blender_addon.scene.faults import TORN
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.match import match_objects
from blender_addon.services.matching.pair_match import _contradicts_names
from blender_addon.services.matching.parts import read_parts
from blender_addon.services.matching.select_faults import select_faults
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from zoomout_core.matching.report.verdict import GREEN, RED, judge
from zoomout_core.samples.spheres import ball

WRONG = judge(0.1)


@pytest.fixture
def wrong(monkeypatch):
    """Make matches probably wrong."""
    monkeypatch.setattr(zo.MatchResult, "verdict", WRONG)


def test_the_verdict_is_stored_with_the_match(source, target):
    found = match_objects(bpy.context, source, target, k_final=30)
    assert found.verdict.level == GREEN
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    assert stored_match.read(target.data, pair).verdict == found.verdict
    np.testing.assert_array_equal(stored_match.read(target.data, pair).torn, found.torn)


@pytest.mark.parametrize("damaged", [["green"], ["pink", "a", "b"], "green", 3, None])
def test_damaged_verdict_is_ignored(damaged):
    assert stored_match.verdict_of({"verdict": damaged}) is None


def test_a_new_match_that_is_probably_wrong_stops_the_transfer_once(source, target, wrong):
    add_uv_map(source.data, "Layout")
    with pytest.raises(zo.MeshError, match=r"'Target' was matched but not changed.*force=True"):
        transfer_objects(bpy.context, source, target, ["uv_maps"], k_final=30)
    assert "Layout" not in target.data.uv_layers
    assert stored_match.verdict_of(stored_match.description(target.data)).level == RED
    report = transfer_objects(bpy.context, source, target, ["uv_maps"])
    assert report["written"]["uv_maps"] == ["Layout"]
    assert report["verdict"]["level"] == RED


@pytest.mark.slow
@pytest.mark.parametrize("operate", ["wrap", "dress"])
def test_probably_wrong_match_stops_wrap_and_dress_once(source, target, wrong, operate):
    worn = ellipsoid("Shirt", 3)
    worn.scale = (1.2,) * 3
    bpy.context.view_layer.update()
    given = ([worn],) if operate == "dress" else ()
    before = set(bpy.data.objects)
    with pytest.raises(zo.MeshError, match="'Target' was matched but not changed"):
        getattr(api, operate)(bpy.context, source, target, *given, k_final=30)
    assert target.data.shape_keys is None
    assert set(bpy.data.objects) == before
    assert getattr(api, operate)(bpy.context, source, target, *given)
    stored_match.remove(target.data)
    assert getattr(api, operate)(bpy.context, source, target, *given, k_final=30, force=True)


def test_force_transfers_along_a_probably_wrong_match(source, target, wrong, tmp_path, capsys):
    add_uv_map(source.data, "Layout")
    arguments = ["transfer", "--source", "Source", "--target", "Target", "--data", "uv_maps", "--k-final", "30"]
    report = tmp_path / "report.json"
    assert cli.main([*arguments, "--report", str(report)]) == 1
    error = json.loads(report.read_text())["targets"]["Target"]["error"]
    assert "probably wrong" in error
    assert error.endswith("give --force.")
    stored_match.remove(target.data)
    capsys.readouterr()
    assert cli.main([*arguments, "--force", "--report", str(report)]) == 0
    assert "Layout" in target.data.uv_layers
    said = capsys.readouterr().out.splitlines()
    place = said.index("zoomout: transfer to 'Target' done")
    assert said[place + 1].startswith("zoomout:   Red: The match is probably wrong")
    # The match is stored now, so that options of a match have no effect.
    assert cli.main([*arguments[:-1], "20", "--report", str(report)]) == 0
    unused, *_ = json.loads(report.read_text())["targets"]["Target"]["warnings"]
    assert unused.startswith("The existing match was used")
    assert f"zoomout:   Warning: {unused}" in capsys.readouterr().out.splitlines()


def test_operator_explains_how_to_use_the_match_anyway(source, target, wrong):
    add_uv_map(source.data, "Layout")
    activate(target, source)
    with pytest.raises(RuntimeError, match=r"To use this match anyway, press Transfer\."):
        bpy.ops.zoomout.transfer(k_final=30)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}


def test_undoing_a_transfer_keeps_its_match(source, target):
    add_uv_map(source.data, "Layout")
    activate(target, source)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.zoomout.transfer("EXEC_DEFAULT", True, k_final=30) == {"FINISHED"}
    bpy.ops.ed.undo()
    target = bpy.data.objects["Target"]
    assert "Layout" not in target.data.uv_layers
    assert stored_match.description(target.data) is not None
    matched = snapshot(target)
    bpy.ops.ed.undo()
    assert snapshot(bpy.data.objects["Target"]) != matched
    assert stored_match.description(bpy.data.objects["Target"].data) is None


def test_torn_vertices_are_selected(source, target):
    keep_true_match(target)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    kept = stored_match.read(target.data, pair)
    torn = np.arange(len(kept.confidence)) < 7
    stored_match.write(target.data, replace(kept, torn=torn), pair, {})
    assert select_faults(bpy.context, target, TORN).startswith("Torn: 7 vertices of 'Target'")
    stored_match.write(target.data, replace(kept, torn=None), pair, {})
    with pytest.raises(zo.MeshError, match="no information about torn places"):
        select_faults(bpy.context, target, TORN)


def two_parts():
    """A body and a smaller lump next to it in one object, with two materials."""
    body = ellipsoid("Body", 4)
    vertices = np.array([vertex.co[:] for vertex in body.data.vertices])
    faces = [list(polygon.vertices) for polygon in body.data.polygons]
    mesh = bpy.data.meshes.new("Both")
    mesh.from_pydata(
        np.concatenate([vertices, 0.4 * vertices + [1.2, 0, 0]]),
        [],
        faces + [[corner + len(vertices) for corner in face] for face in faces],
    )
    obj = link("Both", mesh)
    for name in ("Skin", "Hair"):
        mesh.materials.append(new_material(name))
    for polygon in mesh.polygons:
        polygon.material_index = polygon.index >= len(faces)
    return body, obj


def test_name_contradictions_are_weighted_by_area():
    target = ball(1.0)
    vertex = np.arange(len(target.vertices))
    result = SimpleNamespace(target=target, surface_map=zo.SurfaceMap.from_vertices(vertex, target))
    right = [(vertex[half::2], vertex[half::2]) for half in (0, 1)]
    fingers = [(vertex[:1], vertex[i : i + 1]) for i in range(1, 9)]
    assert not _contradicts_names(result, right + fingers)
    swapped = [(vertex[::2], vertex[1::2]), (vertex[1::2], vertex[::2])]
    assert _contradicts_names(result, swapped)
    assert not _contradicts_names(result, ())


def test_faces_have_the_names_of_their_objects_and_materials():
    body, both = two_parts()
    pair = jobs.run(read_pair(bpy.context, both.name, body.name))
    names, number = read_parts(bpy.context, pair)
    label = [names[part].label for part in number]
    slots = np.array([polygon.material_index for polygon in both.data.polygons])[pair.source.triangle_face]
    assert label == [["Skin", "Hair"][slot] for slot in slots]
    pair = jobs.run(read_pair(bpy.context, body.name, both.name))
    assert [name.label for name in read_parts(bpy.context, pair).names] == ["Body"]
