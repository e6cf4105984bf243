# SPDX-License-Identifier: GPL-3.0-or-later
"""The life of the extension in one Blender: installed, used, saved with, disabled, uninstalled. In this order."""

import importlib
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import addon_utils
import bpy
import numpy as np
import pytest
from archive import ARCHIVE, CONTENT, EXTENSION, MANIFEST, USER, WHEELS
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    ellipsoid,
    new_material,
    positions,
    set_weights,
    snapshot_file,
    values,
    weight_array,
)

# The offset of the shape key on the source.
TALL = np.array([1, 1, 1.5], np.float32)

# Opens the saved file in a new process, and transfers along the match that was kept. It ends as conftest.py does.
LATER = """
import os
import sys
import bpy
import addon_utils
file, extension = sys.argv[1:]
bpy.ops.wm.open_mainfile(filepath=file)
assert addon_utils.enable(extension, default_set=True) is not None
assert bpy.ops.zoomout.transfer() == {"FINISHED"}
os._exit(0)
"""


@pytest.fixture
def pair(installed):
    """A source with all kinds of data, and its shape as the target, rotated and with another order of vertices."""
    bpy.ops.wm.read_homefile(use_empty=True)
    source, target = ellipsoid("Source", 4), ellipsoid("Target", 4)
    order = np.random.default_rng(0).permutation(len(target.data.vertices))
    place = np.argsort(order)
    faces = [[int(place[vertex]) for vertex in polygon.vertices] for polygon in target.data.polygons]
    shuffled = bpy.data.meshes.new("Shuffled")
    shuffled.from_pydata(positions(target.data)[order].tolist(), [], faces)
    add_attribute(shuffled, "truth", "INT", "POINT", order)
    target.data = shuffled
    target.rotation_euler = (0.3, 1.2, 2.0)
    bpy.context.view_layer.update()
    give_data(source)
    activate(target, source)
    return source, target


def give_data(source):
    points = positions(source.data)
    add_uv_map(source.data, "UVMap")
    set_weights(source, "Bone", smooth(points))
    add_attribute(
        source.data, "Paint", "FLOAT_COLOR", "POINT", np.c_[smooth(points)[:, None].repeat(3, 1), points[:, 0] * 0 + 1]
    )
    add_attribute(source.data, "Height", "FLOAT", "POINT", points[:, 2])
    source.data.materials.append(new_material("Skin"))
    source.shape_key_add(name="Basis")
    tall = source.shape_key_add(name="Tall")
    tall.data.foreach_set("co", (points * TALL).ravel())
    tall.value = 0  # in Blender 5.0 and newer it begins at 1
    upper = Counter(key for face in source.data.polygons if face.center.z > 0.1 for key in face.edge_keys)
    for edge in source.data.edges:
        edge.use_edge_sharp = upper[edge.key] == 1
    source.data.normals_split_custom_set_from_vertices(points / np.linalg.norm(points, axis=1)[:, None])


def smooth(points):
    return np.clip(0.5 + points[:, 0], 0, 1)


def test_zip_passes_validation_by_blender():
    scripts = Path(bpy.utils.system_resource("SCRIPTS"))
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    tags = scripts / "modules" / "_bpy_internal" / "extensions" / "tags.py"
    command = [sys.executable, tool, "validate", f"--valid-tags={tags}", ARCHIVE]
    judged = subprocess.run(command, capture_output=True, text=True)
    assert judged.returncode == 0, judged.stdout + judged.stderr


def test_zip_contains_only_expected_files_and_no_forbidden_code():
    suffixes = {name.partition("/")[0] == "docs": set() for name in CONTENT}
    for name in CONTENT:
        suffixes[name.partition("/")[0] == "docs"].add(Path(name).suffix)
    assert suffixes == {True: {".html", ".png"}, False: {".py", ".toml", ""}}
    assert [name for name in CONTENT if "." not in name] == ["LICENSE"]
    assert sorted(f"./{name}" for name in WHEELS) == MANIFEST["wheels"]
    assert not any(Path(name).name.startswith("numpy") for name in WHEELS)
    code = {name: text.decode() for name, text in CONTENT.items() if name.endswith(".py")}
    refused = re.compile(r"\bimport threading|from threading|\beval\(|\bexec\(|sys\.path|sys\.modules")
    assert [name for name, text in code.items() if refused.search(text)] == []


def test_extension_uses_its_own_wheels_and_numpy_of_blender(installed):
    for name in ("zoomout_core", "scipy", "robust_laplacian", "fast_simplification", "threadpoolctl"):
        assert USER in Path(sys.modules[name].__file__).parents, name
    assert USER not in Path(np.__file__).parents
    assert "blender_addon" not in sys.modules


def test_match_is_accurate(pair):
    source, target = pair
    assert bpy.ops.zoomout.match() == {"FINISHED"}
    source.data.calc_loop_triangles()
    triangles = np.array([triangle.vertices for triangle in source.data.loop_triangles])
    corners = positions(source.data)[triangles[values(target.data, "zoomout_triangle")]]
    image = np.einsum("nc,ncx->nx", values(target.data, "zoomout_barycentric"), corners)
    truth = positions(source.data)[values(target.data, "truth")]
    assert np.linalg.norm(image - truth, axis=1).mean() < 0.02


def test_a_linked_target_follows_the_source(pair):
    source, target = pair
    bpy.ops.zoomout.match()
    assert bpy.ops.zoomout.keep_linked() == {"FINISHED"}
    for name, element in (("Height", "value"), ("UVMap", "vector"), ("Paint", "color")):
        before = linked_values(target, name)
        changed = values(source.data, name) / 2
        source.data.attributes[name].data.foreach_set(element, changed.ravel())
        source.data.update()
        assert np.isclose(linked_values(target, name), before / 2, atol=1e-5).mean() > 0.95


@pytest.mark.parametrize("way", ["appended", "linked", "overridden"])
def test_a_link_survives_use_in_another_file(pair, tmp_path, way):
    """An appended target follows the appended source, others the source that is edited in its own file."""
    bpy.ops.zoomout.match()
    assert bpy.ops.zoomout.keep_linked() == {"FINISHED"}
    both = bpy.data.collections.new("Both")
    bpy.context.scene.collection.children.link(both)
    for obj in pair:
        both.objects.link(obj)
    before = linked_values(pair[1], "Height")
    library, scene = str(tmp_path / "library.blend"), str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=library)
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(library, link=way != "appended") as (_, into):
        into.collections = ["Both"]
    if way == "overridden":
        into.collections[0].override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
    else:
        bpy.context.scene.collection.children.link(into.collections[0])
    np.testing.assert_allclose(linked_values(used("Target"), "Height"), before, atol=1e-6)
    bpy.ops.wm.save_as_mainfile(filepath=scene)
    if way != "appended":
        bpy.ops.wm.open_mainfile(filepath=library)
    mesh = bpy.data.objects["Source"].data
    mesh.attributes["Height"].data.foreach_set("value", values(mesh, "Height") / 2)
    mesh.update()
    if way != "appended":
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=scene)
    found = linked_values(used("Target"), "Height")
    assert np.isclose(found, before / 2, atol=1e-5).mean() > 0.95
    assert np.ptp(found) > 0.1


def used(name):
    """The object of the scene with a name, of several in the file."""
    return next(obj for obj in bpy.context.scene.objects if obj.name == name)


def linked_values(target, name):
    evaluated = target.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return values(evaluated.data, name).copy()


def test_a_match_that_is_cancelled_leaves_the_file_as_it_was(pair):
    before = snapshot_file()
    services = importlib.import_module(f"{EXTENSION}.services.matching.match")
    jobs = importlib.import_module(f"{EXTENSION}.jobs")
    job = jobs.Job(services.match(bpy.context, "Source", "Target"))
    assert not any(job.advance(0) for _ in range(5))
    assert job.progress.fraction < 1
    job.cancel()
    assert snapshot_file() == before


def test_every_kind_of_data_arrives(pair):
    source, target = pair
    assert bpy.ops.zoomout.transfer(source="Source") == {"FINISHED"}
    assert_arrived(source, target)
    report = json.loads(target.data["zoomout_report"])
    options = bpy.ops.zoomout.transfer.get_rna_type().properties
    missing = {kind for kind, names in report["written"].items() if options[kind].default and not names}
    assert missing == set()


def assert_arrived(source, target):
    order = values(target.data, "truth")
    points = positions(source.data)[order]
    corner_vertex = np.array([loop.vertex_index for loop in target.data.loops])
    np.testing.assert_allclose(values(target.data, "UVMap"), points[corner_vertex, :2] / 4 + 0.5, atol=0.02)
    np.testing.assert_allclose(weight_array(target, "Bone"), smooth(points), atol=0.05)
    np.testing.assert_allclose(values(target.data, "Paint")[:, 0], smooth(points), atol=0.05)
    np.testing.assert_allclose(values(target.data, "Height"), points[:, 2], atol=0.05)
    assert list(target.data.materials) == [bpy.data.materials["Skin"]]
    tall = np.array([vertex.co for vertex in target.data.shape_keys.key_blocks["Tall"].data])
    np.testing.assert_allclose(tall, points * TALL, atol=0.05)
    lines = {frozenset(order[list(edge)]) for edge in sharp_edges(target.data)}
    truth = {frozenset(edge) for edge in sharp_edges(source.data)}
    assert len(lines & truth) > 0.9 * len(lines | truth) > 0


def sharp_edges(mesh):
    return [edge.key for edge in mesh.edges if edge.use_edge_sharp]


def test_match_survives_saving_and_reopening(pair, tmp_path):
    file = str(tmp_path / "matched.blend")
    assert bpy.ops.zoomout.match() == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    kept = bpy.data.objects["Target"].data["zoomout_match"]
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    source, target = bpy.data.objects["Source"], bpy.data.objects["Target"]
    assert_arrived(source, target)
    assert target.data["zoomout_match"] == kept
    later = subprocess.run([sys.executable, "-P", "-c", LATER, file, EXTENSION], capture_output=True, text=True)
    assert later.returncode == 0, later.stdout + later.stderr


def test_command_line_transfers_vertex_groups(pair):
    command = importlib.import_module(f"{EXTENSION}.cli").main
    assert command(["transfer", "--source", "Source", "--target", "Target", "--data", "vertex_groups"]) == 0
    np.testing.assert_allclose(
        weight_array(pair[1], "Bone"), smooth(positions(pair[0].data)[values(pair[1].data, "truth")]), atol=0.05
    )


def test_options_are_kept_as_presets(installed):
    settings = bpy.context.scene.zoomout
    settings.detail = "FINE"
    assert bpy.ops.zoomout.add_match_preset(name="Heads") == {"FINISHED"}
    settings.detail = "FAST"
    kept = Path(bpy.utils.preset_find("Heads", "zoomout/match"))
    assert USER in kept.parents
    menu = "ZOOMOUT_PT_match_presets"
    assert bpy.ops.script.execute_preset(filepath=str(kept), menu_idname=menu) == {"FINISHED"}
    assert settings.detail == "FINE"
    assert bpy.utils.preset_find("rig", "zoomout/transfer")  # came along


def test_preferences_link_to_whats_new_of_this_version(installed):
    found = bpy.context.preferences.addons[EXTENSION].preferences
    assert type(found).__name__ == "ZOOMOUT_AP_preferences"
    assert found.prepare_ahead
    manual = importlib.import_module(f"{EXTENSION}.ui.manual")
    news = Path(url2pathname(urlparse(manual.address(manual.NEWS)).path)).read_text(encoding="utf-8")
    assert f">{MANIFEST['version']}</h2>" in news


def test_guide_ships_with_the_extension(installed):
    manual = importlib.import_module(f"{EXTENSION}.ui.manual")
    addresses = {
        bpy.types.WM_OT_doc_view_manual._lookup_rna_url(f"bpy.ops.zoomout.{name}", verbose=False)
        for name in ("match", "transfer")
    }
    assert addresses == {manual.address(page) for page in (manual.GUIDE, manual.RULES)}
    for address in addresses:
        page = Path(url2pathname(urlparse(address).path))
        assert USER in page.parents
        assert "<html" in page.read_text(encoding="utf-8")


def test_extension_disables_without_trace_and_re_enables(installed):
    enabled = traces()
    assert {"Scene.zoomout", "zoomout.match", "zoomout.transfer"} <= set(enabled)
    assert addon_utils.enable(EXTENSION, default_set=True) is not None  # again
    assert traces() == enabled
    bpy.ops.preferences.addon_disable(module=EXTENSION)
    assert traces() == {}
    bpy.ops.preferences.addon_enable(module=EXTENSION)
    assert traces() == enabled


def traces():
    """The number of our registered items in Blender, by kind."""
    properties = [
        f"{kind.__name__}.{prop.identifier}"
        for kind in (bpy.types.Scene, bpy.types.Object, bpy.types.Mesh, bpy.types.WindowManager)
        for prop in kind.bl_rna.properties
    ]
    operators = [f"zoomout.{name}" for name in dir(bpy.ops.zoomout)]
    found = [name for name in (*properties, *operators, *dir(bpy.types)) if "zoomout" in name.lower()]
    lists = {name: getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)}
    callbacks = [(name, each) for name, known in lists.items() if isinstance(known, list) for each in known]
    draws = {name: getattr(getattr(bpy.types, name), "draw", None) for name in dir(bpy.types)}
    callbacks += [(name, each) for name, draw in draws.items() for each in getattr(draw, "_draw_funcs", ())]
    found += [f"{name}: {each.__qualname__}" for name, each in callbacks if each.__module__.startswith(EXTENSION)]
    keymaps = bpy.context.window_manager.keyconfigs.addon.keymaps
    found += [item.idname for keymap in keymaps for item in keymap.keymap_items if item.idname.startswith("zoomout")]
    return Counter(found)


def test_uninstalling_removes_the_wheels(installed):
    repository = next(repo for repo in bpy.context.preferences.extensions.repos if repo.module == "user_default")
    assert bpy.ops.extensions.package_uninstall(repo_directory=repository.directory, pkg_id=MANIFEST["id"]) == {
        "FINISHED"
    }
    assert traces() == {}
    assert addon_utils.check(EXTENSION) == (False, False)
    left = [path for path in (USER / "extensions").rglob("*") if path.suffix in (".py", ".so", ".whl")]
    assert left == []
