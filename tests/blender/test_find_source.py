# SPDX-License-Identifier: GPL-3.0-or-later
"""Find a source in a library, and append it."""

import json
import struct
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from drawing import Context, Layout
from scenes import activate, from_pydata, set_weights, snapshot_file, weight_array

import zoomout_core as zo
from blender_addon import api
from blender_addon.cli import main
from blender_addon.scene.files import save_scene
from blender_addon.scene.selection import library_folders
from blender_addon.services import found_pictures
from blender_addon.services.found_pictures import last_pictures
from blender_addon.services.library import Search, append_source, read_assets
from blender_addon.ui import thumbnails
from blender_addon.ui.panels import library
from zoomout_core.library.pictures import draw_pair
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.samples import creature

pytestmark = pytest.mark.usefixtures("coarse_hulls")


@pytest.fixture
def target():
    surface = creature(900, seed=1, bend=0.9).surface
    obj = from_pydata("Scan", surface.vertices, surface.triangles)
    activate(obj)
    return obj


@pytest.fixture
def folder(tmp_path):
    write_shape(creature(1000).surface, tmp_path / "hero.ply")
    (tmp_path / "broken.obj").write_text("f 1 2 3\n")
    return tmp_path


def test_a_search_lists_files_and_appends_none(target, folder):
    settings = bpy.context.scene.zoomout
    settings.library_folder = str(folder)
    objects = set(bpy.data.objects)
    assert bpy.ops.zoomout.find_source() == {"FINISHED"}
    assert set(bpy.data.objects) == objects
    (found,) = settings.found_sources
    assert found.name == str(folder / "hero.ply")
    assert found.fits
    assert found.line.startswith("hero: fit ")
    assert list(last_pictures) == [folder / "hero.ply"]
    assert settings.found_for == target.name
    assert bpy.ops.zoomout.append_source(path=found.name) == {"FINISHED"}
    assert settings.source.name == "hero"
    assert bpy.data.collections["hero"].objects[:] == [settings.source]
    assert bpy.context.active_object == target


def test_found_source_is_shown_in_matching_colours(target, tmp_path, monkeypatch):
    settings, path = bpy.context.scene.zoomout, tmp_path / "hero.blend"
    # The start of a .blend file: a header, and a block with width, height and pixels of the thumbnail.
    pixels = struct.pack("<ii", 2, 2) + bytes([255, 0, 0, 255] * 4)
    path.write_bytes(b"BLENDER-v402TEST" + struct.pack("<IQII", len(pixels), 0, 0, 0) + pixels)
    turned = creature(900, seed=1).surface
    match = SimpleNamespace(
        source=turned,
        target=turned.with_vertices(turned.vertices[:, [0, 2, 1]] * [1, -1, 1]),
        surface_map=zo.SurfaceMap.from_vertices(np.arange(len(turned.vertices)), turned),
        confidence=np.ones(len(turned.vertices)),
    )
    of_source, of_target = draw_pair(match, 64, 64, blender=True)
    assert np.abs(of_source.astype(int) - of_target).max() <= 2
    assert (thumbnails._without_paper(of_source)[..., 3] > 0).mean() > 0.05
    settings.found_for = target.name
    settings.found_sources.clear()
    settings.found_sources.add().name = str(path)
    for pictures, count in (((), 1), ((of_source, of_target), 3)):
        monkeypatch.setattr(found_pictures, "last_pictures", {path: pictures})
        panel = SimpleNamespace(layout=Layout([]))
        library.ZOOMOUT_PT_library.draw(panel, Context())
        assert [kind for kind, *_ in panel.layout.drawn].count("icon") == count


def test_another_source_of_a_part_limits_transfers_to_its_vertex_groups(target, folder, monkeypatch):
    settings, path = bpy.context.scene.zoomout, folder / "hero.ply"
    best = zo.FoundSource(folder / "body.glb", 0.4, 0.97, 0.06)
    part = zo.FoundPart(path, best.path, "Head", ("Head", "Jaw"), 0.992, 0.957)

    async def find_at_once(*_):
        return Search(zo.FoundSources((best,), best.path, "", part), {}, {})

    monkeypatch.setattr("blender_addon.services.library.find_source_async", find_at_once)
    settings.library_folder = str(folder)
    assert bpy.ops.zoomout.find_source() == {"FINISHED"}
    panel = SimpleNamespace(layout=Layout([]))
    library.ZOOMOUT_PT_library.draw(panel, Context())
    assert "Head: hero, fit 99.2% instead of 95.7%" in [text for kind, text, *_ in panel.layout.drawn]
    found = {"path": settings.found_part, "joints": settings.found_part_joints}
    objects = set(bpy.data.objects)
    with pytest.raises(RuntimeError, match="no vertex group 'Head': transfer the vertex groups of the best source"):
        bpy.ops.zoomout.append_source(**found)
    assert set(bpy.data.objects) == objects
    head = np.linspace(0, 0.75, len(target.data.vertices))
    set_weights(target, "Head", head)
    set_weights(target, "Jaw", np.full(len(head), 0.25))
    set_weights(target, "Spine", 0.75 - head)
    assert bpy.ops.zoomout.append_source(**found) == {"FINISHED"}
    assert (settings.source.name, settings.mask_group) == ("hero", "Head Mask")
    np.testing.assert_allclose(weight_array(target, "Head Mask"), head + 0.25, atol=1e-6)
    # A search without such a part forgets it.
    part = None
    assert bpy.ops.zoomout.find_source() == {"FINISHED"}
    assert settings.found_part == ""


@pytest.mark.slow
def test_scripts_find_sources_without_a_selection(target, folder):
    search = api.find_source(bpy.context, target, [str(folder)])
    assert [each.path.stem for each in search.found.ranked] == ["hero"]
    assert [path.name for path in search.failures] == ["broken.obj"]
    assert api.append_source(bpy.context, search.found.best.path).name == "hero"


def test_library_without_readable_files_gives_the_reason(target, folder):
    (folder / "hero.ply").unlink()
    bpy.context.scene.zoomout.library_folder = str(folder)
    with pytest.raises(RuntimeError, match=r"No file of .* can be used: .*broken\.obj"):
        bpy.ops.zoomout.find_source()


def test_a_search_needs_a_library(target, tmp_path):
    assert not bpy.ops.zoomout.find_source.poll()
    bpy.context.scene.zoomout.library_folder = str(tmp_path / "missing")
    with pytest.raises(RuntimeError, match="There is no folder"):
        bpy.ops.zoomout.find_source()


def test_asset_libraries_of_preferences_are_searched(folder):
    libraries = bpy.context.preferences.filepaths.asset_libraries
    libraries.new(name="Characters", directory=str(folder))
    bpy.context.scene.zoomout.use_asset_libraries = True
    try:
        assert str(folder) in [path.rstrip("/\\") for path in library_folders(bpy.context)]
        libraries.new(name="Missing", directory=str(folder / "missing"))
        assert all(Path(path).is_dir() for path in library_folders(bpy.context))
    finally:
        for name in ("Characters", "Missing"):
            libraries.remove(libraries[name])


def test_the_largest_mesh_of_a_blend_file_is_the_source(target, tmp_path):
    small = from_pydata("Eye", [(0, 0, 0), (100, 0, 0), (0, 100, 0)], [(0, 1, 2)])
    small.scale = (0.001, 0.001, 0.001)  # as an importer's, for units
    path = tmp_path / "hero.blend"
    save_scene(path)
    bpy.data.objects.remove(small)
    bpy.data.objects.remove(target)
    source = append_source(bpy.context, path)
    assert source.name == "Scan"
    assert sorted(obj.name for obj in bpy.data.collections["hero"].objects) == ["Eye", "Scan"]
    with pytest.raises(zo.MeshError, match="There is no file"):
        append_source(bpy.context, tmp_path / "missing.blend")


def test_the_open_file_is_not_appended_to_itself(target, tmp_path):
    save_scene(tmp_path / "hero.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "hero.blend"))
    with pytest.raises(zo.MeshError, match="is the open file"):
        append_source(bpy.context, tmp_path / "hero.blend")


def test_append_keeps_selection_and_failure_leaves_nothing(target, tmp_path):
    save_scene(tmp_path / "hero.blend")
    selected = list(bpy.context.selected_objects)
    append_source(bpy.context, tmp_path / "hero.blend")
    assert bpy.context.selected_objects == selected
    marker = bpy.data.objects.new("Marker", None)
    bpy.data.libraries.write(str(tmp_path / "marker.blend"), {marker})
    before = set(bpy.data.objects.keys()), set(bpy.data.collections.keys())
    with pytest.raises(zo.MeshError, match="has no mesh"):
        append_source(bpy.context, tmp_path / "marker.blend")
    assert (set(bpy.data.objects.keys()), set(bpy.data.collections.keys())) == before


@pytest.mark.parametrize("ending", [".blend", ".glb", ".ply"])
def test_append_is_one_undo_step(target, tmp_path, ending):
    path = tmp_path / f"hero{ending}"
    save_scene(path)
    other = from_pydata("Other", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    bpy.context.view_layer.update()
    activate(target, other)
    bpy.ops.ed.undo_push(message="before")
    before = snapshot_file()
    assert bpy.ops.zoomout.append_source("EXEC_DEFAULT", True, path=str(path)) == {"FINISHED"}
    source = bpy.context.scene.zoomout.source
    assert source.name != "Scan"
    assert (bpy.context.active_object.name, len(bpy.context.selected_objects)) == ("Scan", 2)
    bpy.ops.ed.undo()
    assert snapshot_file() == before
    assert bpy.context.scene.zoomout.source is None
    assert bpy.context.active_object.name == "Scan"
    assert {obj.name for obj in bpy.context.selected_objects} == {"Scan", "Other"}
    bpy.ops.ed.redo()
    assert bpy.context.scene.zoomout.source is not None


@pytest.fixture
def pack(target, tmp_path):
    """A file with a rigged hero in a marked collection, a marked dog and other things, of which nothing is loaded."""
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    target.modifiers.new("Rig", "ARMATURE").object = armature
    target.modifiers.new("Wave", "DISPLACE").strength = 0.0
    hero = bpy.data.collections.new("Hero")
    eye, hidden, dog, rest = (
        from_pydata(name, [(0, 0, 0), (size, 0, 0), (0, size, 0)], [(0, 1, 2)])
        for name, size in (("Eye", 0.1), ("Hidden", 50), ("Dog", 1), ("Rest", 2))
    )
    hidden.hide_viewport = True
    for obj in (target, eye, hidden):
        hero.objects.link(obj)
    for marked in (hero, target, dog, armature):
        marked.asset_mark()
    dog.preview_ensure()
    dog.preview.image_size = (8, 8)
    dog.preview.image_pixels_float[:] = [1.0] * 8 * 8 * 4
    path = tmp_path / "pack.blend"
    bpy.data.libraries.write(str(path), {hero, dog, rest, armature})
    for obj in (target, eye, hidden, dog, rest, armature):
        bpy.data.objects.remove(obj)
    bpy.data.collections.remove(hero)
    return path


def test_marked_assets_of_a_file_are_read_as_surfaces(pack, tmp_path):
    shapes = {name: len(surface.vertices) for name, surface in read_assets(bpy.context, str(pack)).items()}
    assert shapes == {"Collection/Hero": 900 + 3, "Object/Dog": 3}
    report = tmp_path / "report.json"
    assert main(["assets", str(pack), "--folder", str(tmp_path), "--report", str(report)]) == 0
    written = {name: each["file"] for name, each in json.loads(report.read_text())["assets"].items()}
    assert {name: len(zo.read_surface(tmp_path / file).vertices) for name, file in written.items()} == shapes


def test_asset_is_appended_with_its_rig_and_preview(pack):
    source = append_source(bpy.context, pack / "Collection" / "Hero")
    assert source.name == "Hidden"  # the largest
    (hero,) = bpy.context.scene.collection.children
    assert sorted(obj.name for obj in hero.objects) == ["Eye", "Hidden", "Rig", "Scan"]
    assert hero.asset_data is None
    assert append_source(bpy.context, pack / "Object" / "Dog").name == "Dog"
    assert set(bpy.data.objects.keys()) == {"Eye", "Hidden", "Rig", "Scan", "Dog"}
    with pytest.raises(zo.MeshError, match=r"pack\.blend has no asset 'Cat': prepare the library again"):
        append_source(bpy.context, pack / "Object" / "Cat")
    assert thumbnails.icon_of_file(str(pack / "Object" / "Dog")) is not None
    assert thumbnails.icon_of_file(str(pack / "Collection" / "Hero")) is None


def test_a_file_with_a_marked_sword_is_still_a_character(target, tmp_path):
    sword = from_pydata("Sword", [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)], [(0, 1, 2)])
    sword.asset_mark()
    save_scene(tmp_path / "hero.blend")
    shapes = {
        name: len(surface.vertices) for name, surface in read_assets(bpy.context, str(tmp_path / "hero.blend")).items()
    }
    assert shapes == {"": 903, "Object/Sword": 3}


def test_a_file_without_marked_meshes_is_one_asset(target, tmp_path):
    target.data.materials.append(bpy.data.materials.new("Skin"))
    target.data.materials[0].asset_mark()
    save_scene(tmp_path / "hero.blend")
    (surface,) = read_assets(bpy.context, str(tmp_path / "hero.blend")).values()
    assert len(surface.vertices) == 900
    (tmp_path / "hero.blend").write_bytes(b"none")
    with pytest.raises(zo.MeshError, match="could not open"):
        read_assets(bpy.context, str(tmp_path / "hero.blend"))


def test_library_command_prepares_folders(folder, tmp_path, capsys):
    report = tmp_path / "report.json"
    assert main(["library", str(folder), "--report", str(report)]) == 0
    entry = json.loads(report.read_text())["folders"][str(folder)]
    assert (entry["assets"], entry["new"]) == (1, 1)
    said = capsys.readouterr().out
    assert "1 characters, 1 of them new" in said
    assert f"{folder / 'broken.obj'} was skipped. " in said
    (folder / "hero.ply").unlink()
    assert main(["library", str(folder)]) == 1
    assert main(["library"]) == 1
    assert "The Preferences have no asset library" in capsys.readouterr().err
    assert main(["library", "a", "b", "--index", "c"]) == 2
