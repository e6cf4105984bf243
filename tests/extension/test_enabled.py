# SPDX-License-Identifier: GPL-3.0-or-later
"""All other features of the installed extension than a match and a transfer, once each, with its own wheels."""

import doctest
import importlib
import json
from collections import Counter

import bmesh
import bpy
import numpy as np
import pytest
from archive import EXTENSION
from scenes import (
    ELEMENTS,
    activate,
    add_attribute,
    add_uv_map,
    decimate,
    ellipsoid,
    positions,
    set_weights,
    snapshot_file,
    values,
    weight_array,
)

# `test_installed.py` has a match as users run it.
pytestmark = pytest.mark.usefixtures("installed", "quick_search")

zoomout = bpy.ops.zoomout


def part(name):
    """A module of the installed extension."""
    return importlib.import_module(f"{EXTENSION}.{name}")


@pytest.fixture
def scene(installed):
    bpy.ops.wm.read_homefile(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def source(scene):
    obj = ellipsoid("Source", 4)
    add_uv_map(obj.data, "UVMap")
    set_weights(obj, "Bone", np.clip(positions(obj.data)[:, 0], 0, 1))
    return obj


@pytest.fixture
def target(source):
    """The same shape with fewer triangles at the same place."""
    obj = decimate("Target", 4)
    bpy.context.view_layer.update()
    activate(obj, source)
    return obj


@pytest.fixture
def matched(source, target):
    assert zoomout.match(initial="PROXIMITY") == {"FINISHED"}
    return target


@pytest.fixture
def symmetric(scene):
    """A mesh with mirror symmetry and no other one."""
    obj = ellipsoid("Symmetric", 4, radii=(1, 0.7, 0.5))
    points = positions(ellipsoid("Plain", 4).data)
    directions = points / np.linalg.norm(points, axis=1)[:, None]
    bumps = [np.exp(-8 * ((directions - (side * 0.6, 0.5, 0.62)) ** 2).sum(axis=1)) for side in (-1, 1)]
    shape = directions * (1.0, 0.7, 0.5) * (1 + 0.8 * np.sum(bumps, axis=0)[:, None])
    obj.data.vertices.foreach_set("co", np.ascontiguousarray(shape, np.float32).ravel())
    obj.data.update()
    activate(obj)
    return obj


def triangles(obj):
    return values(obj.data, "zoomout_triangle").copy()


@pytest.mark.parametrize("domain", ["POINT", "FACE", "CORNER"])
def test_every_type_of_attribute_arrives(source, matched, domain):
    mesh = source.data
    known = mesh.attributes.bl_rna.functions["new"].parameters["type"].enum_items.keys()
    assert {"FLOAT_COLOR", "QUATERNION", "FLOAT4X4"} < set(known)
    count = {"POINT": len(mesh.vertices), "FACE": len(mesh.polygons), "CORNER": len(mesh.loops)}[domain]
    sent = {}
    for data_type, (_, width, dtype) in ((name, ELEMENTS[name]) for name in ELEMENTS if name in known):
        one = np.eye(4).ravel() if width == 16 else np.array([0, 0, 0, 1] if width == 4 else [1] * width)
        sent[f"Kept {data_type}"] = one.astype(dtype)
        add_attribute(mesh, f"Kept {data_type}", data_type, domain, np.tile(one, (count, 1)))
    assert zoomout.transfer(source="Source") == {"FINISHED"}
    for name, one in sent.items():
        arrived = matched.data.attributes[name]
        assert (arrived.data_type, arrived.domain) == (mesh.attributes[name].data_type, domain)
        apart = np.abs(values(matched.data, name).reshape(-1, len(one)).astype(float) - one)
        assert apart.max() < 1e-5, name


def test_edge_marks_and_shape_are_transferred(source, matched):
    upper = Counter(key for face in source.data.polygons if face.center.z > 0 for key in face.edge_keys)
    around = [upper[edge.key] == 1 for edge in source.data.edges]
    source.data.edges.foreach_set("use_seam", around)
    for name in ("crease_edge", "bevel_weight_edge"):
        add_attribute(source.data, name, "FLOAT", "EDGE", around)
    assert zoomout.transfer(source="Source", uv_maps=False, shape=True) == {"FINISHED"}
    seams = [edge.index for edge in matched.data.edges if edge.use_seam]
    assert len(seams) > 10
    for name in ("crease_edge", "bevel_weight_edge"):
        assert np.count_nonzero(values(matched.data, name)[seams]) == len(seams)
    assert "Source" in matched.data.shape_keys.key_blocks


@pytest.mark.parametrize("start", ["LANDMARKS", "PROXIMITY", "NEAREST", "SAME_ORDER"])
def test_match_starts_from_landmarks_proximity_or_vertex_order(source, start):
    twin = ellipsoid("Twin", 4)
    bpy.context.view_layer.update()
    activate(twin, source)
    api = part("api")
    for number, vertex in enumerate((0, 5, 100), start=1):
        for obj in (source, twin):
            api.set_landmark(bpy.context, obj, number, vertex)
    assert zoomout.match(initial=start) == {"FINISHED"}
    source.data.calc_loop_triangles()
    corners = np.array([triangle.vertices for triangle in source.data.loop_triangles])[triangles(twin)]
    found = np.einsum("nc,ncx->nx", values(twin.data, "zoomout_barycentric"), positions(source.data)[corners])
    assert np.linalg.norm(found - positions(twin.data), axis=1).mean() < 0.05


def test_landmarks_are_placed_from_selection_removed_and_cleared(source, target):
    for obj in (source, target):
        obj.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    for obj in (source, target):
        editable = bmesh.from_edit_mesh(obj.data)
        editable.verts.ensure_lookup_table()
        for vertex in editable.verts:
            vertex.select = vertex.index in (3, 50)
        bmesh.update_edit_mesh(obj.data)
    assert zoomout.landmarks_from_selected() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    landmarks = bpy.context.scene.zoomout.landmarks
    assert [len(landmark.places) for landmark in landmarks] == [2, 2]
    assert zoomout.remove_landmark() == {"FINISHED"}
    assert len(landmarks) == 1
    assert zoomout.clear_landmarks() == {"FINISHED"}
    assert len(landmarks) == 0


def test_choosing_another_candidate_is_reversible(source, target):
    assert zoomout.match() == {"FINISHED"}
    first = triangles(target)
    listing = part("storage.stored_candidates").read(target.data)
    colors = np.array([candidate.colors for candidate in listing.candidates], float)
    other = int(np.abs(colors - colors[listing.chosen]).mean(axis=(1, 2)).argmax())
    assert zoomout.use_candidate(candidate=other + 1) == {"FINISHED"}
    assert (triangles(target) != first).mean() > 0.5
    assert zoomout.use_candidate(candidate=listing.chosen + 1) == {"FINISHED"}
    np.testing.assert_array_equal(triangles(target), first)


def test_transfer_to_several_targets_is_one_undo_step(source, target):
    other = decimate("Other", 4)
    bpy.context.view_layer.update()
    activate(target, other, source)
    bpy.context.scene.zoomout.source = source
    bpy.ops.ed.undo_push(message="before")
    before = snapshot_file()
    assert zoomout.transfer("EXEC_DEFAULT", True, initial="PROXIMITY") == {"FINISHED"}
    assert [obj.data.uv_layers.keys() for obj in (target, other)] == [["UVMap"]] * 2
    bpy.ops.ed.undo()
    assert snapshot_file() == before


def test_collections_are_matched_part_by_part(source, target):
    settings = bpy.context.scene.zoomout
    eyes = [ellipsoid(f"{owner} Eye", 2) for owner in ("Source", "Target")]
    for eye in eyes:
        eye.location, eye.scale = (1.05, 0, 0), (0.1, 0.1, 0.1)
    bpy.context.view_layer.update()
    for role, objects in (("source", (source, eyes[0])), ("target", (target, eyes[1]))):
        collection = bpy.data.collections.new(role)
        bpy.context.scene.collection.children.link(collection)
        for obj in objects:
            collection.objects.link(obj)
        setattr(settings, f"{role}_collection", collection)
    assert zoomout.match_collections() == {"FINISHED"}
    kept = {obj.name: json.loads(obj.data["zoomout_match"])["source"] for obj in (target, eyes[1])}
    assert kept == {"Target": "Source", "Target Eye": "Source Eye"}


def test_cutting_seams_keeps_the_match(source, matched):
    upper = np.array([loop.vertex_index for loop in source.data.loops]).reshape(-1, 3)
    upper = (positions(source.data)[upper, 2].mean(axis=1) > 0).repeat(3)
    source.data.uv_layers["UVMap"].data.foreach_set(
        "uv", np.ascontiguousarray(values(source.data, "UVMap") / 4 + 0.5 * upper[:, None], np.float32).ravel()
    )
    source.data.update()
    before = len(matched.data.vertices)
    assert zoomout.cut_seams() == {"FINISHED"}
    assert len(matched.data.vertices) > before
    assert part("services.preflight").stale(bpy.context, matched) == ""
    assert zoomout.transfer() == {"FINISHED"}


def test_preview_colours_are_removed_without_a_trace(source, matched):
    before = snapshot_file()
    for kind in ("CONFIDENCE", "PLACES", "CHECKER"):
        assert zoomout.preview(kind=kind) == {"FINISHED"}
        assert part("viewport.preview").preview_of(matched).kind == kind
    assert zoomout.clear_preview() == {"FINISHED"}
    assert part("viewport.overlay").overlays() == ()
    assert snapshot_file() == before


def test_edited_target_makes_match_out_of_date(source, matched):
    matched.data.vertices[3].co.x += 0.1
    bpy.context.view_layer.update()
    part("services.preflight").stale(bpy.context, matched)
    part("scene.mesh_facts").inspect_now()
    assert (
        part("services.preflight").stale(bpy.context, matched)
        == "The target 'Target' was edited after the match: match again."
    )
    with pytest.raises(RuntimeError, match="'Target' was edited since it was matched: match again"):
        zoomout.transfer()


def test_every_symmetry_operator_works(symmetric):
    points = positions(symmetric.data)
    left, right = points[:, 0] > 0.05, points[:, 0] < -0.05
    assert zoomout.detect_symmetry() == {"FINISHED"}
    for swapped in range(2):
        assert zoomout.swap_sides() == {"FINISHED"}, swapped
    sculpted = points * (1 + 0.1 * np.clip(points[:, :1], 0, 1))
    symmetric.data.vertices.foreach_set("co", sculpted.ravel())
    assert zoomout.mirror_sculpt() == {"FINISHED"}
    assert (np.abs(positions(symmetric.data) - points).max(axis=1)[points[:, 0] < -0.3] > 0.005).all()
    points = positions(symmetric.data)
    assert zoomout.name_sides() == {"FINISHED"}
    assert (weight_array(symmetric, "Side.L")[left] > 0.5).mean() > 0.95
    set_weights(symmetric, "Arm.L", np.clip(points[:, 0], 0, 1))
    symmetric.vertex_groups.new(name="Arm.R")
    assert zoomout.symmetrise_weights() == {"FINISHED"}
    assert np.abs(weight_array(symmetric, "Arm.R")[right] + points[right, 0]).mean() < 0.03
    symmetric.shape_key_add(name="Basis")
    smile = symmetric.shape_key_add(name="Smile.L")
    smile.data.foreach_set("co", (points + np.outer(np.clip(points[:, 0], 0, 1), (0, 0, 0.2))).ravel())
    symmetric.active_shape_key_index = 1
    assert zoomout.mirror_shape_key() == {"FINISHED"}
    assert "Smile.R" in symmetric.data.shape_keys.key_blocks
    add_attribute(symmetric.data, "Height", "FLOAT", "POINT", np.where(left, points[:, 2], 0))
    assert zoomout.mirror_attributes() == {"FINISHED"}
    assert np.abs(values(symmetric.data, "Height")[right] - points[right, 2]).mean() < 0.03
    for kind in ("PAIRS", "SIDES"):
        assert zoomout.preview(kind=kind) == {"FINISHED"}
    for work in (zoomout.check_symmetry, zoomout.clear_preview):
        assert work() == {"FINISHED"}
    assert zoomout.select_symmetry_line() == {"FINISHED"}
    assert zoomout.choose_symmetry() == {"FINISHED"}


def test_the_command_line_matches_transfers_saves_and_reports(source, target, tmp_path):
    command, out, report = part("cli"), tmp_path / "out.blend", tmp_path / "report.json"
    of_both = ["--source", "Source", "--target", "Target", "--initial", "proximity", "--report", str(report)]
    assert command.main(["match", *of_both]) == 0
    assert json.loads(report.read_text())["targets"]["Target"]["vertices"] == len(target.data.vertices)
    assert command.main(["transfer", *of_both, "--data", "uv_maps", "--save", str(out)]) == 0
    assert json.loads(report.read_text())["targets"]["Target"]["written"]["uv_maps"] == ["UVMap"]
    assert command.main(["transfer", "--source", "Nobody", "--target", "Target"]) == 1
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert bpy.data.objects["Target"].data.uv_layers.keys() == ["UVMap"]


def test_the_example_of_the_api_runs(source, symmetric):
    api = part("api")
    source.name, symmetric.name = "Hero", "Body"
    set_weights(symmetric, "Arm.L", np.clip(positions(symmetric.data)[:, 0], 0, 1))
    scan, hat = ellipsoid("Scan", 4), ellipsoid("Hat", 2, (0.3, 0.3, 0.3))
    bpy.context.view_layer.update()
    names = {"api": api, "context": bpy.context, "hero": source, "scan": scan, "hat": hat, "body": symmetric}
    (example,) = [test for test in doctest.DocTestFinder().find(api, globs=names) if test.name == api.__name__]
    assert len(example.examples) > 5
    assert doctest.DocTestRunner().run(example).failed == 0
