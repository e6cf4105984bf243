# SPDX-License-Identifier: GPL-3.0-or-later
"""`faces` transfers the keys of a head to another, and writes a picture of all of them."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest
from scenes import decimate, ellipsoid, link, positions

from blender_addon import cli
from blender_addon.mesh_data import read_full_offsets, text_triangles
from blender_addon.services.expressions import find_stretched
from blender_addon.services.matching.match import match_objects
from zoomout_core import drawing
from zoomout_core.expression_sheet import GAP, HEIGHT, LINE, WIDTH

KEYS = {
    "jawOpen": ((0.3, -0.4, -0.2), (0, 0, -0.1)),
    "browInnerUp_L": ((0.5, 0.0, 0.3), (0, 0, 0.1)),
    "browInnerUp_R": ((-0.5, 0.0, 0.3), (0, 0, 0.1)),
    "cheekPuff": ((0.3, -0.5, 0.2), (0, -0.1, 0)),
}

# The eye of the head that receives the keys: cheekPuff pushes the skin into it.
CLOSER = 0.3, -0.78, 0.1


def add_expressions(obj):
    """Four keys of a head, each in its own place."""
    points = positions(obj.data)
    obj.shape_key_add(name="Basis", from_mix=False)
    for name, (place, offset) in KEYS.items():
        near = np.exp(-10 * ((points - place) ** 2).sum(axis=1))
        moved = points + np.where(near < 0.05, 0, near)[:, None] * offset
        block = obj.shape_key_add(name=name, from_mix=False)
        block.points.foreach_set("co", moved.astype(np.float32).ravel())
    for block in obj.data.shape_keys.key_blocks:
        block.value = 0  # Blender 5 adds keys at full strength
    return obj


def read_png(path):
    image = bpy.data.images.load(str(path))
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1, :, :3]


@pytest.fixture(autouse=True)
def _draw_quickly(monkeypatch):
    monkeypatch.setattr(drawing, "SAMPLES", 1)


@pytest.fixture
def files(tmp_path, empty_scene):
    """A head with keys and an eye without, and the same with other triangles, without keys and the eye in their way."""
    made = []
    for name in ("hero", "scan"):
        bpy.ops.wm.read_homefile(use_empty=True)
        head = add_expressions(ellipsoid("Hero", 4)) if name == "hero" else decimate("Scan", 4)
        eye = ellipsoid(f"{head.name} Eye", 2, (0.1, 0.1, 0.1))
        eye.location = (0.4, -0.9, 0.1) if name == "hero" else CLOSER
        made.append(tmp_path / f"{name}.blend")
        bpy.ops.wm.save_as_mainfile(filepath=str(made[-1]), copy=True)
    return made


def run(*arguments):
    return cli.main([str(argument) for argument in ("faces", *arguments)])


def test_all_keys_are_drawn_and_renamed(files, tmp_path, capsys):
    sheet, report, out = tmp_path / "sheet.png", tmp_path / "report.json", tmp_path / "out.blend"
    options = "--detail", "fast", "--sheet", sheet, "--report", report, "--save", out, "--key-names", "arkit"
    assert run(*files, *options) == 0, capsys.readouterr().err
    picture = read_png(sheet)
    columns = picture.shape[1] // (2 * WIDTH + GAP)
    rows = -(-(1 + len(KEYS)) // columns)
    assert picture.shape[:2] == (GAP + rows * (LINE + HEIGHT + GAP), GAP + columns * (2 * WIDTH + GAP))
    first = picture[GAP : GAP + LINE + HEIGHT, GAP : GAP + 2 * WIDTH]
    assert first[:LINE].min() < 0.3  # its label
    assert first[LINE:, :WIDTH].std() > 0.05
    assert first[LINE:, WIDTH:].std() > 0.05
    done = json.loads(report.read_text())["targets"]
    assert list(done) == ["Scan"]  # the eye has no keys to receive
    assert done["Scan"]["written"]["shape_keys"] == list(KEYS)
    assert done["Scan"]["stretched_by_keys"] == {}
    assert list(done["Scan"]["intersecting_by_keys"]) == ["cheekPuff"]
    assert "browInnerUp = browInnerUp_L + browInnerUp_R" in done["Scan"]["notes"][-1]
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert bpy.data.objects["Scan"].data.shape_keys.key_blocks.keys() == ["Basis", *KEYS, "browInnerUp"]
    assert set(bpy.data.objects.keys()) == {"Scan", "Scan Eye"}


def test_a_source_without_keys_is_an_error_and_no_picture_is_written(files, tmp_path, capsys):
    assert run(files[1], files[0], "--detail", "fast", "--sheet", tmp_path / "sheet.png") == 1
    assert "has none of the data to transfer" in capsys.readouterr().err
    assert not (tmp_path / "sheet.png").exists()


def test_sheet_must_be_a_separate_png_file(files, tmp_path, capsys):
    assert run(*files, "--sheet", tmp_path / "sheet.jpg") == 2
    assert "give a name that ends in .png" in capsys.readouterr().err
    assert run(*files, "--sheet", tmp_path / "sheet.png", "--report", tmp_path / "sheet.png") == 1
    assert "--report and --sheet both name" in capsys.readouterr().err


def test_edges_that_stretch_more_than_on_the_source_are_found(empty_scene):
    source, target = add_expressions(ellipsoid("Source", 4)), add_expressions(ellipsoid("Target", 4))
    match = match_objects(bpy.context, source, target, detail="fast")
    assert not any(found.any() for found in find_stretched(bpy.context, ["Source"], "Target", match).values())
    block = target.data.shape_keys.key_blocks["jawOpen"]
    torn = 40
    block.points[torn].co.z += 1
    found = find_stretched(bpy.context, ["Source"], "Target", match)
    assert found["jawOpen"][torn]
    assert not found["cheekPuff"].any()


def test_topology_changing_source_modifiers_are_not_compared(empty_scene):
    source, target = add_expressions(ellipsoid("Source", 4)), add_expressions(ellipsoid("Target", 4))
    match = match_objects(bpy.context, source, target, detail="fast")
    match = replace(match, surface_map=replace(match.surface_map, source_triangles=np.zeros((7, 3), int)))
    assert find_stretched(bpy.context, ["Source"], "Target", match) == {}


def test_keys_are_read_through_their_masks(empty_scene):
    obj = add_expressions(ellipsoid("Head", 3))
    assert read_full_offsets(link("Plain", bpy.data.meshes.new("Plain"))) == {}
    half = obj.vertex_groups.new(name="Half")
    half.add(list(range(len(obj.data.vertices))), 0.5, "REPLACE")
    whole = read_full_offsets(obj)["jawOpen"]
    obj.data.shape_keys.key_blocks["jawOpen"].vertex_group = "Half"
    np.testing.assert_allclose(read_full_offsets(obj)["jawOpen"], whole / 2)
    obj.vertex_groups.remove(half)
    np.testing.assert_array_equal(read_full_offsets(obj)["jawOpen"], whole)  # as Blender shows it


def test_text_triangles_leave_no_objects(empty_scene):
    before = len(bpy.data.objects), len(bpy.data.curves), len(bpy.data.meshes)
    short, long = text_triangles("eye"), text_triangles("eyeBlink_L")
    assert short[1].max() < len(short[0])
    assert long[0][:, 0].max() > 2 * short[0][:, 0].max()
    assert text_triangles("")[1].shape == (0, 3)
    assert (len(bpy.data.objects), len(bpy.data.curves), len(bpy.data.meshes)) == before
