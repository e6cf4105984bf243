# SPDX-License-Identifier: GPL-3.0-or-later
"""A collection of .blend files, processed in child processes: transferred data equals the truth."""

import json
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from character import character, pose_copy
from click.testing import CliRunner
from scenes import add_attribute, ellipsoid, key_shape, new_material, positions, values

import zoomout_core as zo
from zoomout_core.cli import main
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.formats import blender_files

pytestmark = pytest.mark.slow

# Radii, and the place of an eye before the head is rotated.
EYE = (0.06, 0.05, 0.05)
PLACE = np.array([0.15, -0.75, 2.15])


def write_hero(path):
    """Write a rigged character with position-dependent colours, a shape key and an eye; return all but the eye."""
    body, rig = character(levels=2)
    mesh, rest = body.data, positions(body.data)
    mesh.materials.append(new_material("Fur"))
    add_attribute(mesh, "Paint", "FLOAT_COLOR", "POINT", np.column_stack([rest / 4 + 0.5, np.ones(len(rest))]))
    body.shape_key_add(name="Basis")
    key = body.shape_key_add(name="Tall")
    key.points.foreach_set("co", (rest * np.float32((1, 1, 1.2))).ravel())
    key.value = 0
    eye = ellipsoid("Eye", 3, EYE)
    eye.location = PLACE
    eye.data.materials.append(new_material("Glass"))
    bpy.context.view_layer.update()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    bpy.data.objects.remove(eye)
    return body, rig


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folders and the output of a run, and the places of the scans' vertices on the hero at rest."""
    folder, output = tmp_path_factory.mktemp("shapes"), tmp_path_factory.mktemp("out")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    body, rig = write_hero(folder / "hero.blend")
    scan, posed = pose_copy(body, rig, 0.06)
    hero = zo.Surface(positions(body.data), [list(polygon.vertices) for polygon in body.data.polygons])
    found = closest_points(positions(scan.data), positions(posed.data), hero.triangles)
    true = zo.SurfaceMap(*found, hero.triangles).interpolate(hero.vertices)
    near = np.linalg.norm(hero.vertices - PLACE, axis=1).argmin()
    turned = positions(posed.data)[near] - hero.vertices[near]
    for obj in (posed, body, rig):
        bpy.data.objects.remove(obj)
    bpy.data.orphans_purge(do_recursive=True)
    bpy.ops.export_scene.fbx(filepath=str(folder / "print.fbx"))
    eye = ellipsoid("Eyeball", 2, EYE)
    eye.location = PLACE + turned
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scan.blend"), copy=True)
    done = collection(folder, output)
    return SimpleNamespace(folder=folder, output=output, said=done.output, status=done.exit_code, true=true)


def collection(folder, output):
    line = f"collection {folder} -o {output} --template {folder}/hero.blend --transfer --detail fast --workers 1"
    return CliRunner().invoke(main, [*line.split(), "--no-pictures", "--no-agree"])


def check(target, true):
    """Compare a scan's data with the truth."""
    mesh = target.data
    off = np.linalg.norm(4 * (values(mesh, "Paint")[:, :3] - 0.5) - true, axis=1)
    assert np.median(off) < 0.04  # of a height of 2.2
    assert np.percentile(off, 95) < 0.2
    assert mesh.uv_layers.keys() == ["UVMap"]
    assert [material.name for material in mesh.materials] == ["Fur"]
    sizes = [len(polygon.vertices) for polygon in mesh.polygons]
    assert set(sizes) == {4}
    assert mesh.shape_keys.key_blocks.keys() == ["Basis", "Tall", "Posed Shape"]
    height = key_shape(mesh, "Tall") - key_shape(mesh, "Basis")
    assert np.median(np.abs(height[:, 2] - 0.2 * true[:, 2])) < 0.04
    assert target.find_armature().name == "Rig"
    # It stands where the hero does at rest.
    stands = np.linalg.norm(key_shape(mesh, "Basis") - true, axis=1)
    assert np.median(stands) < 0.04


def test_scan_of_two_objects_receives_all_data(run):
    assert run.status == 0, run.said
    bpy.ops.wm.open_mainfile(filepath=str(run.output / "meshes" / "scan.blend"))
    assert set(bpy.data.objects.keys()) == {"Target", "Eyeball", "Rig"}
    check(bpy.data.objects["Target"], run.true)
    assert [material.name for material in bpy.data.objects["Eyeball"].data.materials] == ["Glass"]


def test_an_fbx_receives_the_same(run):
    bpy.ops.wm.open_mainfile(filepath=str(run.output / "meshes" / "print.blend"))
    target = next(obj for obj in bpy.data.objects if obj.type == "MESH")
    check(target, run.true)


def test_the_report_names_what_could_not_be_bound(run):
    report = json.loads((run.output / "report.json").read_text())
    assert any("'Eyeball' was not bound" in note for note in report["transferred"]["scan"])


def test_second_run_does_not_start_blender(run, monkeypatch):
    before = {path: path.stat().st_mtime_ns for path in (run.output / "meshes").iterdir()}
    monkeypatch.setattr(blender_files.subprocess, "Popen", None)
    done = collection(run.folder, run.output)
    assert done.exit_code == 0, done.output
    assert {path: path.stat().st_mtime_ns for path in (run.output / "meshes").iterdir()} == before
