# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands that open files: the visible surface of one file, and transfer from one file to another."""

import json
import shutil

import bpy
import numpy as np
import pytest
from blend_files import PAINT, write_pair, write_true_map
from rigged import BONES, OTHER, truth, visible_positions
from scenes import ellipsoid, key_shape, link, positions, values, weight_array

import zoomout_core as zo
from blender_addon import cli
from zoomout_core.matching.report.verdict import judge
from zoomout_core.mesh.formats.files import read_surface


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


@pytest.fixture
def files(tmp_path):
    """A hero, a scan of it, the true map between them, and the scan's body at rest."""
    hero, scan, map_file = (tmp_path / name for name in ("hero.blend", "scan.blend", "map.npz"))
    at_rest = write_pair(hero, scan)
    write_true_map(map_file, hero, scan, at_rest)
    return hero, scan, map_file, at_rest


def carry(hero, scan, map_file, output, *more):
    return run("carry", hero, scan, "--map", map_file, "--save", output, *more)


def check_body(body, at_rest):
    """Compare the data of the scan's body with the truth."""
    corner_vertex = values(body.data, ".corner_vert")
    off = values(body.data, "Skin") - (at_rest[corner_vertex][:, :2] / 4 + 0.5)
    assert np.abs(off).max() < 0.01
    np.testing.assert_allclose(values(body.data, "Paint"), np.tile(PAINT, (len(at_rest), 1)), atol=1e-6)
    assert [material.name for material in body.data.materials] == ["Leather"]
    assert set(body.vertex_groups.keys()) == set(BONES)


def test_carry_transfers_everything_between_files(files, tmp_path):
    hero, scan, map_file, at_rest = files
    out, path = tmp_path / "out.blend", tmp_path / "report.json"
    assert carry(hero, scan, map_file, out, "--bind", "--report", path) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert set(bpy.data.objects.keys()) == {"Body", "Eyeball", "Hidden", "Rig"}
    body, rig = bpy.data.objects["Body"], bpy.data.objects["Rig"]
    check_body(body, at_rest)
    sizes = [len(polygon.vertices) for polygon in body.data.polygons]
    assert (sizes.count(4), len(sizes)) == (15 * 46, 15 * 46 + 2)
    assert body.data.shape_keys.key_blocks.keys() == ["Basis", "Wide", "Posed Shape"]
    wide = key_shape(body.data, "Wide") - key_shape(body.data, "Basis")
    assert np.median(np.linalg.norm(wide - at_rest * [0.5, 0.5, 0], axis=1)) < 0.02
    assert [modifier.type for modifier in body.modifiers] == ["ARMATURE", "SUBSURF"]
    body.modifiers["Smooth"].show_viewport = False
    posed = truth(rig, OTHER, at_rest)
    assert np.median(np.linalg.norm(visible_positions(body) - posed, axis=1)) < 0.02
    assert bpy.data.objects["Eyeball"].data.uv_layers.keys() == ["Skin"]
    assert bpy.data.objects["Hidden"].hide_get()
    assert not bpy.data.objects["Hidden"].data.uv_layers
    assert not [each for each in body.data.attributes if each.name.startswith("zoomout")]
    assert len(bpy.data.libraries) == 0
    assert len(bpy.data.armatures) == 1
    targets = json.loads(path.read_text())["targets"]
    assert targets["Body"]["bound"] == {"armature": "Rig", "shape": "rest_pose"}
    assert [note for note in targets["Eyeball"]["notes"] if "not bound" in note]


def test_carry_without_binding_adds_no_rig(files, tmp_path):
    hero, scan, map_file, at_rest = files
    before = scan.read_bytes()
    out = tmp_path / "out.blend"
    assert carry(hero, scan, map_file, out) == 0
    assert scan.read_bytes() == before
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert set(bpy.data.objects.keys()) == {"Body", "Eyeball", "Hidden"}
    assert not bpy.data.armatures
    check_body(bpy.data.objects["Body"], at_rest)


@pytest.mark.parametrize("ending", ["fbx", "glb"])
def test_results_are_exported(files, tmp_path, ending):
    hero, scan, map_file, _ = files
    out = tmp_path / f"out.{ending}"
    assert carry(hero, scan, map_file, out, "--bind") == 0
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith((".", "out"))) == [out.name]
    assert run("surface", out, "--save", tmp_path / "out.ply") == 0
    body = bpy.data.objects["Body"]
    assert [material.name for material in body.data.materials] == ["Leather"]
    assert set(BONES) <= set(body.vertex_groups.keys())
    assert "Wide" in body.data.shape_keys.key_blocks
    assert body.find_armature() is not None
    # Nothing that only shows bones, which Blender's importer of glTF may add.
    assert {obj.name for obj in bpy.data.objects if obj.type == "MESH"} == {"Body", "Eyeball", "Hidden"}


def test_a_file_that_is_imported_is_a_source_too(files, tmp_path):
    hero, scan, _, at_rest = files
    bpy.ops.wm.open_mainfile(filepath=str(hero))
    fbx, map_file, out = (tmp_path / name for name in ("hero.fbx", "fbx.npz", "out.blend"))
    bpy.ops.export_scene.fbx(filepath=str(fbx))
    write_true_map(map_file, fbx, scan, at_rest)
    assert carry(fbx, scan, map_file, out, "--bind") == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    body = bpy.data.objects["Body"]
    assert body.parent.type == "ARMATURE"
    assert {"Body", "Eyeball", "Hidden"} < set(bpy.data.objects.keys())
    assert not {"Hero", "Eye"} & set(bpy.data.objects.keys())
    assert body.data.uv_layers.keys() == ["Skin"]


def two_files(tmp_path):
    """Two files with an ellipsoid each, the first with weights."""
    for name, subdivisions in (("one", 4), ("other", 5)):
        bpy.ops.wm.read_homefile(use_empty=True)
        obj = ellipsoid(name, subdivisions)
        if name == "one":
            obj.vertex_groups.new(name="All").add(list(range(len(obj.data.vertices))), 1, "REPLACE")
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / f"{name}.blend"), copy=True)
    return tmp_path / "one.blend", tmp_path / "other.blend"


def test_probably_wrong_match_requires_force(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(zo.MatchResult, "verdict", judge(0.1))
    arguments = "carry", *two_files(tmp_path), "--detail", "fast", "--save", tmp_path / "out.blend"
    assert run(*arguments) == 1
    assert "give --force" in capsys.readouterr().err
    assert not (tmp_path / "out.blend").exists()
    assert run(*arguments, "--force") == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    assert "All" in bpy.data.objects["other"].vertex_groups


def test_files_are_matched_where_there_is_no_map(tmp_path):
    assert run("carry", *two_files(tmp_path), "--detail", "fast", "--save", tmp_path / "out.blend") == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    assert weight_array(bpy.data.objects["other"], "All").min() > 0.99


def test_exported_surface_has_blenders_world_space_triangles(tmp_path):
    plate = bpy.data.meshes.new("Plate")
    plate.from_pydata([(0, 0, 0), (2, 0, 0), (2, 2, 0), (1, 0.2, 0), (0, 2, 0)], [], [(0, 1, 2, 3, 4)])
    obj = link("Plate", plate)
    obj.location.z, obj.scale.x = 3, -1
    obj.modifiers.new("Twice", "SUBSURF")
    hidden = ellipsoid("Hidden", 2)
    hidden.hide_set(True)
    link("Lines", bpy.data.meshes.new("Lines"))
    path = tmp_path / "plate.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    report = tmp_path / "report.json"
    assert run("surface", path, "--save", tmp_path / "own.ply", "--report", report) == 0
    assert json.loads(report.read_text())["objects"] == {"Plate": {"vertices": 5, "faces": 1, "triangles": 3}}
    own = read_surface(tmp_path / "own.ply")
    plate = bpy.data.meshes["Plate"]
    plate.calc_loop_triangles()
    np.testing.assert_array_equal(own.triangles, [list(each.vertices)[::-1] for each in plate.loop_triangles])
    np.testing.assert_allclose(own.vertices, positions(plate) * [-1, 1, 1] + [0, 0, 3], atol=1e-6)
    assert run("surface", path, "--role", "source", "--save", tmp_path / "seen.ply") == 0
    assert len(read_surface(tmp_path / "seen.ply").vertices) == 11


def test_surface_contains_objects_visible_in_the_saved_file(tmp_path):
    ellipsoid("Elsewhere", 2)
    window = bpy.context.window
    window.scene = bpy.data.scenes.new("Other")
    window.view_layer = window.scene.view_layers.new("Second")
    ellipsoid("Shown", 2)
    ellipsoid("Hidden", 3).hide_set(True)
    path, report = tmp_path / "left.blend", tmp_path / "report.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    bpy.ops.wm.read_homefile(use_empty=True)
    assert run("surface", path, "--save", tmp_path / "out.ply", "--report", report) == 0
    assert list(json.loads(report.read_text())["objects"]) == ["Shown"]


def test_a_file_that_was_left_in_edit_mode_is_read(tmp_path):
    obj = ellipsoid("Mesh", 3)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "edited.blend"), copy=True)
    assert run("surface", tmp_path / "edited.blend", "--save", tmp_path / "out.ply") == 0


def test_unreadable_or_empty_files_give_one_sentence(tmp_path, capsys):
    empty, broken, other = (tmp_path / name for name in ("empty.blend", "broken.blend", "note.txt"))
    bpy.ops.wm.save_as_mainfile(filepath=str(empty), copy=True)
    broken.write_bytes(b"BLENDER-v500" + bytes(100))
    other.write_text("no mesh")
    sentences = {
        empty: "has no visible mesh with faces",
        broken: "Blender could not open",
        other: "is not supported: convert it to",
        tmp_path / "none.blend": "There is no file",
    }
    for path, sentence in sentences.items():
        assert run("surface", path, "--save", tmp_path / "out.ply") == 1
        said = capsys.readouterr().err
        assert sentence in said
        assert said.count("\n") - said.count("Error: ") <= 1, said
    assert not (tmp_path / "out.ply").exists()


def test_a_map_of_other_surfaces_is_refused_and_nothing_is_written(files, tmp_path, capsys):
    hero, scan, map_file, _ = files
    out = tmp_path / "out.blend"
    swapped = tmp_path / "swapped.npz"
    with np.load(map_file) as arrays:
        held = dict(arrays)
    np.savez(swapped, **held | {"vertex": held["vertex"][::-1]})
    short = tmp_path / "short.npz"
    np.savez(short, **{name: array[:-1] for name, array in held.items()})
    for wrong in (swapped, short):
        assert carry(hero, scan, wrong, out) == 1
        assert "match these two again" in capsys.readouterr().err
    assert carry(hero, scan, scan, out) == 1
    assert "contains no map" in capsys.readouterr().err
    assert not out.exists()


def test_inputs_are_not_overwritten(files, tmp_path, capsys):
    hero, scan, map_file, _ = files
    picture = tmp_path / "skin.png"
    bpy.ops.wm.open_mainfile(filepath=str(scan))
    bpy.data.images.new("Skin", 4, 4).save(filepath=str(picture))
    bpy.data.materials.new("Skin").use_fake_user = True
    bpy.data.images["Skin"].use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(scan), copy=True)
    shutil.copy(picture, tmp_path / "skin.blend")
    bpy.data.images["Skin"].filepath = str(tmp_path / "skin.blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(scan), copy=True)
    for output in (hero, scan, map_file.with_suffix(".txt"), tmp_path / "skin.blend"):
        assert carry(hero, scan, map_file, output) == 1
    said = capsys.readouterr().err
    assert said.count("is an input, and would be overwritten") == 3
    assert "has no supported file extension" in said
    assert carry(hero, hero, map_file, tmp_path / "out.blend") == 1
    assert "is both source and target" in capsys.readouterr().err
    assert carry(hero, scan, map_file, scan, "--in-place") == 0
    bpy.ops.wm.open_mainfile(filepath=str(scan))
    assert bpy.data.objects["Body"].data.uv_layers.keys() == ["Skin"]


def test_asset_of_a_file_is_the_source_and_its_rig_moves(files, tmp_path):
    hero, scan, map_file, at_rest = files
    bpy.ops.wm.open_mainfile(filepath=str(hero))
    asset, scene = bpy.data.collections.new("Hero"), bpy.context.scene.collection
    for obj in list(scene.objects):
        scene.objects.unlink(obj)
        asset.objects.link(obj)
    scene.children.link(asset)
    asset.asset_mark()
    ellipsoid("Sword", 5)
    bpy.ops.wm.save_as_mainfile(filepath=str(hero), copy=True)
    source, out, path = hero / "Collection" / "Hero", tmp_path / "out.blend", tmp_path / "report.json"
    assert carry(source, scan, map_file, out, "--move-rig", "--report", path) == 0
    assert "moved" in json.loads(path.read_text())["targets"]["Body"]["bound"]
    bpy.ops.wm.open_mainfile(filepath=str(out))
    check_body(bpy.data.objects["Body"], at_rest)
    assert bpy.data.objects["Body"].find_armature() is not None
    assert "Sword" not in bpy.data.objects
    assert carry(hero / "Collection" / "Dog", scan, map_file, tmp_path / "none.blend") == 1
    assert carry(source, scan, map_file, hero) == 1  # it would overwrite the source


@pytest.mark.filterwarnings("ignore:load")
def test_linked_source_is_refused_in_a_sentence(tmp_path, capsys):
    library, hero, scan = (tmp_path / name for name in ("library.blend", "hero.blend", "scan.blend"))
    ellipsoid("Linked", 4)
    for path in (library, scan):
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = ["Linked"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(hero), copy=True)
    assert run("carry", hero, scan, "--save", tmp_path / "out.blend") == 1
    assert "'Linked' is linked into its file from another file" in capsys.readouterr().err


def test_output_format_follows_the_file_extension(tmp_path):
    source, target = ellipsoid("Source", 4), ellipsoid("Target", 4)
    bpy.context.view_layer.update()
    assert source.data != target.data
    out = tmp_path / "out.glb"
    assert run("match", "--source", "Source", "--target", "Target", "--initial", "same_order", "--save", out) == 0
    assert len(zo.read_surface(out).triangles) == 2 * len(target.data.polygons)
