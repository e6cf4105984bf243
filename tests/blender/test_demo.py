# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo, at a size that takes seconds; one run serves all tests of its results."""

import json
from itertools import product

import bpy
import numpy as np
import pytest

import blender_addon
import zoomout_core as zo
from blender_addon import mesh_data
from blender_addon.demo import FULL_SIZE, Size, make_demo_objects, run, shape, summary, truth
from blender_addon.demo.character import LEFT, PAINT, RIGHT, UV_MAP
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.samples.implicit import distance, surface_net
from zoomout_core.transfer import Attribute, Domain, Kind, cut_mesh

SMALL = Size(cell=0.025, voxel=0.02, target_vertices=4500, width=240, samples=1)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder and the report of a run in a session where the add-on is not registered, and what it began with."""
    folder = tmp_path_factory.mktemp("demo")
    built = []

    def make_and_save(size):
        built.append(make_demo_objects(size))
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "objects.blend"), copy=True)
        return built[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("blender_addon.demo.make_demo_objects", make_and_save)
        report = run(folder / "new" / "folder", SMALL)
    assert not hasattr(bpy.types.Scene, "zoomout"), "the demo left its add-on registered"
    return folder / "new" / "folder", report, folder / "objects.blend", built[0]


@pytest.fixture
def demo(finished):
    """The folder and the report of the run."""
    return finished[:2]


@pytest.fixture
def prepared(finished):
    """The demo's objects as saved before the match, and as built."""
    return finished[2:]


@pytest.fixture
def objects(empty_scene, prepared):
    """The demo's objects, reloaded from their file."""
    path, built = prepared
    bpy.ops.wm.open_mainfile(filepath=str(path))
    names = {"character": "Character", "armature": "Armature", "target": "ZoomOut", "baseline": "Data Transfer"}
    return built._replace(**{role: bpy.data.objects[name] for role, name in names.items()})


def euler_characteristic(surface):
    edges, edge = unique_edges(surface.triangles)
    assert (np.bincount(edge.ravel()) == 2).all(), "the surface is not closed, or not a manifold"
    return len(np.unique(surface.triangles)) - len(edges) + len(surface.triangles)


def test_transfer_beats_data_transfer_at_least_five_times(demo):
    _, report = demo
    for kind in ("uv", "weights", "color"):
        ours, theirs = report["errors"][kind]["zoomout"]["mean"], report["errors"][kind]["data_transfer"]["mean"]
        assert theirs > 5 * ours, kind
        assert theirs == pytest.approx(min(report["data_transfer_mappings"][kind].values()))
        assert report["errors"][kind]["times_better_on_average"] == pytest.approx(theirs / ours)


def test_report_and_summary_contain_sizes_times_and_versions(demo):
    folder, report = demo
    assert json.loads((folder / "report.json").read_text()) == report
    assert report["versions"]["blender"] == bpy.app.version_string
    assert report["vertices"]["source"] != report["vertices"]["target"]
    assert report["seconds"]["total"] > report["seconds"]["match"] > 0
    text = "\n".join(summary(report))
    for kind in ("uv", "weights", "color", "correspondence"):
        assert f"{report['errors'][kind]['zoomout']['mean']:.4f}" in text


def test_the_picture_shows_every_figure_in_colour(demo):
    folder, _ = demo
    image = bpy.data.images.load(str(folder / "demo.png"))
    width, height = image.size
    assert width == SMALL.width
    pixels = np.array(image.pixels).reshape(height, width, 4)[..., :3]
    strength = pixels.max(axis=2) - pixels.min(axis=2)
    columns = np.array_split(np.arange(round(0.07 * width), width), 3)
    rows = np.array_split(np.arange(round(0.93 * height)), 3)
    for row, column in product(rows, columns):
        figure = strength[np.ix_(row, column)] > 0.25
        assert figure.mean() > 0.05
    border = np.concatenate([strength[[0, -1]].ravel(), strength[:, [0, -1]].ravel()])
    assert border.max() < 0.25, "a figure is cropped"


def test_the_armature_bends_the_target_by_the_transferred_weights(demo):
    folder, _ = demo
    bpy.ops.wm.open_mainfile(filepath=str(folder / "demo.blend"))
    target = bpy.data.objects["ZoomOut"]
    weights = mesh_data.read_weights(target, target.data)
    armature = target.modifiers["Armature"].object
    before = mesh_data.read_target_surface(target, bpy.context.evaluated_depsgraph_get()).vertices
    for bone in armature.pose.bones:
        assert np.allclose(bone.matrix_basis, np.eye(4)), "the pose of the target is not its armature's rest"
    armature.pose.bones["forearm.L"].rotation_quaternion = (0.7, 0, 0, 0.7)
    bpy.context.view_layer.update()
    after = mesh_data.read_target_surface(target, bpy.context.evaluated_depsgraph_get()).vertices
    moved = np.linalg.norm(after - before, axis=1)
    below_elbow = ("forearm.L", "hand.L", "thumb.L", "index.L", "middle.L", "ring.L")
    share = weights.values[:, [weights.labels.index(name) for name in below_elbow]].sum(axis=1)
    assert np.median(moved[share > 0.99]) > 0.1
    assert moved[share == 0].max() < 1e-5


@pytest.mark.parametrize("registered", [True, False])
def test_failed_demo_restores_the_add_on_state(registered, tmp_path, monkeypatch):
    def fail(size):
        assert hasattr(bpy.types.Scene, "zoomout")
        raise zo.MeshError("It failed.")

    monkeypatch.setattr("blender_addon.demo.make_demo_objects", fail)
    if not registered:
        blender_addon.unregister()
    with pytest.raises(zo.MeshError, match="It failed"):
        run(tmp_path, SMALL)
    assert hasattr(bpy.types.Scene, "zoomout") == registered
    if not registered:
        blender_addon.register()


@pytest.mark.slow
def test_the_character_is_one_closed_surface_of_the_promised_size():
    vertices, faces = surface_net(FULL_SIZE.cell, shape.SOLIDS, shape.BOUNDS)
    assert 10_000 <= len(vertices) <= 30_000
    surface = zo.Surface(vertices, faces)
    assert euler_characteristic(surface) == 2
    assert not surface.working.flipped.any()
    assert np.abs(distance(vertices, shape.SOLIDS)).max() < 1e-3


def test_the_character_has_weights_on_the_right_sides_that_sum_to_one(objects):
    weights = mesh_data.read_weights(objects.character, objects.character.data)
    assert np.allclose(weights.values.sum(axis=1), 1, atol=1e-5)
    x = objects.source_surface.vertices[:, 0]
    for column, name in enumerate(weights.labels):
        weight = weights.values[:, [column]].toarray()[:, 0]
        side = {".L": 1, ".R": -1}.get(name[-2:], 0)
        assert weight.sum() > 1, name
        centre = weight @ x / weight.sum()
        assert abs(centre) < 0.01 if side == 0 else side * centre > 0.08, name


def wedge(a, b):
    """Twice the signed area that plane vectors span."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def test_atlas_islands_do_not_overlap_or_mirror(objects):
    uv = mesh_data.read_layer(objects.character.data, UV_MAP).attribute.values
    assert uv.min() >= 0
    assert uv.max() <= 1
    assert 7 <= cut_mesh.cut_surface(objects.source_surface, uv).island.max() + 1 <= 20
    corners = uv[objects.source_surface.triangle_corners].astype(float)
    a, b, c = corners.transpose(1, 0, 2)
    assert (wedge(b - a, c - a) > 0).mean() > 0.999
    covering = np.zeros(500, dtype=int)
    points = corners[np.linspace(0, len(corners) - 1, len(covering)).astype(int)].mean(axis=1)
    for i, point in enumerate(points):
        sides = [wedge(q - p, point - p) for p, q in ((a, b), (b, c), (c, a))]
        covering[i] = np.all(np.array(sides) > 0, axis=0).sum()
    assert (covering > 1).mean() < 0.01


def test_the_target_is_a_bare_closed_mesh_in_another_pose(objects):
    for bare in (objects.target, objects.baseline):
        assert not bare.vertex_groups
        assert not bare.data.uv_layers
        assert not bare.data.color_attributes
    assert objects.target.data != objects.baseline.data
    assert abs(len(objects.target.data.vertices) - SMALL.target_vertices) < 0.05 * SMALL.target_vertices
    assert euler_characteristic(objects.target_surface) == 2
    moved = objects.truth.surface_map.interpolate(objects.source_surface.vertices) - objects.target_surface.vertices
    assert np.linalg.norm(moved, axis=1).mean() > 0.15
    assert not {"Posed", "Dense"} & set(bpy.data.objects.keys())


def test_the_truth_knows_left_from_right(objects):
    assert objects.truth.known.mean() > 0.99
    for rgb, side in ((LEFT, 1), (RIGHT, -1)):
        painted = np.linalg.norm(objects.truth.color - rgb, axis=1) < 0.02
        at_rest = objects.truth.surface_map.interpolate(objects.source_surface.vertices)
        assert painted.sum() > 200
        assert (side * at_rest[painted, 0] > 0).all()


def write_uv(result, values):
    attribute = Attribute(UV_MAP, Domain.CORNER, Kind.UV, values)
    mesh_data.write_layer(result.data, mesh_data.Layer(attribute, mesh_data.Role.UV_MAP, "FLOAT2"))


def test_a_perfect_transfer_has_no_error_and_swapped_sides_are_far_off(objects):
    right, target = objects.truth, objects.target
    write_uv(target, right.uv)
    paint = Attribute(PAINT, Domain.POINT, Kind.COLOR, np.pad(right.color, ((0, 0), (0, 1))))
    mesh_data.write_layer(target.data, mesh_data.Layer(paint, mesh_data.Role.COLOR, "FLOAT_COLOR"))
    mesh_data.write_weights(target, Attribute("", Domain.POINT, Kind.WEIGHT, right.weights, right.group_names))
    assert truth.uv_error(target, right).max() < 1e-6
    assert truth.color_error(target, right).max() < 1e-6
    assert truth.weight_error(target, right).max() < 1e-4
    assert truth.correspondence_error(right.surface_map, right, objects.source_surface).max() == 0
    assert truth.unweighted_vertices(target) == 0

    for group in target.vertex_groups:
        group.name = f"swapped {bpy.utils.flip_name(group.name)}"
    for group in target.vertex_groups:
        group.name = group.name.removeprefix("swapped ")
    assert truth.weight_error(target, right).mean() > 0.8


def test_a_face_that_reaches_across_the_atlas_counts_as_torn(objects):
    uv = np.zeros_like(objects.truth.uv)
    write_uv(objects.baseline, uv)
    assert truth.torn_faces(objects.baseline, objects.target_surface, objects.truth) == 0
    uv[objects.target_surface.face_start[:3]] = 0.9
    write_uv(objects.baseline, uv)
    assert truth.torn_faces(objects.baseline, objects.target_surface, objects.truth) == 3
