# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on registers, unregisters, and is a valid extension."""

import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from creatures import creature
from drawing import Context, Layout
from scenes import activate, ellipsoid, from_pydata

import blender_addon
from blender_addon.operators.base import activity
from blender_addon.ui import menus
from zoomout_core.runtime.progress import Progress


def traces():
    names = {name for name in dir(bpy.types) if "zoomout" in name.lower()}
    names |= {f"zoomout.{name}" for name in dir(bpy.ops.zoomout)}
    names |= {f"Scene.{prop.identifier}" for prop in bpy.types.Scene.bl_rna.properties if "zoomout" in prop.identifier}
    handlers = {
        name: len(getattr(bpy.app.handlers, name))
        for name in dir(bpy.app.handlers)
        if isinstance(getattr(bpy.app.handlers, name), list)
    }
    menus_of_blender = "VIEW3D_MT_object", "VIEW3D_MT_edit_mesh", "MESH_MT_shape_key_context_menu"
    extended = [getattr(bpy.types, menu).is_extended() for menu in menus_of_blender]
    manuals = len(list(bpy.utils.manual_map())), bpy.utils.preset_paths("zoomout/match")
    return names, hasattr(bpy.types.Scene, "zoomout"), handlers, extended, manuals


def test_registering_twice_leaves_no_trace():
    registered = traces()
    assert {"ZOOMOUT_OT_match", "ZOOMOUT_OT_transfer", "zoomout.match", "zoomout.transfer"} <= registered[0]
    blender_addon.unregister()
    without = traces()
    assert without[0] == set()
    assert not without[1]
    blender_addon.register()
    assert traces() == registered
    blender_addon.unregister()
    assert traces() == without
    blender_addon.register()  # as the fixture expects it


def operators():
    return {name: getattr(bpy.ops.zoomout, name) for name in dir(bpy.ops.zoomout)}


def groups_of_properties():
    """The properties of all operators and groups of settings, by the names of their owners."""
    found = {name: operator.get_rna_type() for name, operator in operators().items()}
    groups = [bpy.types.Scene.bl_rna.properties["zoomout"].fixed_type]
    for group in groups:  # grows meanwhile
        found[group.identifier] = group
        groups += [
            option.fixed_type
            for option in group.properties
            if option.type in ("POINTER", "COLLECTION") and option.fixed_type.identifier.startswith("ZOOMOUT")
        ]
    return found


def test_every_operator_option_and_choice_explains_itself():
    assert {"match", "ZOOMOUT_PG_settings", "ZOOMOUT_PG_symmetry", "ZOOMOUT_PG_place"} <= groups_of_properties().keys()
    for name, operator in operators().items():
        assert operator.get_rna_type().description, name
    for owner, group in groups_of_properties().items():
        for option in group.properties:
            if option.identifier not in ("rna_type", "name") and not option.is_hidden:
                assert option.description, (owner, option.identifier)
                for choice in option.enum_items if option.type == "ENUM" else ():
                    assert choice.description, (owner, option.identifier, choice.identifier)


def test_operator_labels_are_unique():
    labels = [operator.get_rna_type().name for operator in operators().values()]
    assert len(set(labels)) == len(labels)


def test_labels_differ_from_those_of_blender():
    modules = [getattr(bpy.ops, name) for name in dir(bpy.ops) if name != "zoomout"]
    others = {getattr(module, name).get_rna_type().name.lower() for module in modules for name in dir(module)}
    assert {"zoom out", "transfer mesh data", "mirror shape key"} <= others
    labels = {operator.get_rna_type().name.lower() for operator in operators().values()}
    assert not labels & others


def test_search_results_name_the_extension():
    """Search shows an item with its menus, and matches the input with all words of both."""
    manifest = tomllib.loads((Path(blender_addon.__file__).parent / "blender_manifest.toml").read_text())
    tops = [menus.ZOOMOUT_MT_object, menus.ZOOMOUT_MT_mesh]
    assert {menu.bl_label for menu in tops} == {manifest["name"]}
    texts = [text for menu in menus.CLASSES for text in drawn_texts(menu)]
    assert not [text for text in texts if "zoom" in text.lower()]  # otherwise it would appear with View > Zoom Out


def drawn_texts(menu):
    layout = Layout([])
    menu.draw(SimpleNamespace(layout=layout), Context())
    return [text for kind, text, _ in layout.drawn if kind == "operator"]


def nothing():
    pass


def a_light():
    bpy.ops.object.light_add()


def one_mesh():
    activate(ellipsoid("Mesh", 2))


def edit_mode():
    one_mesh()
    bpy.ops.object.mode_set(mode="EDIT")


def work_in_a_window():
    one_mesh()
    activity.running = Progress(0.5, "Working")


@pytest.mark.parametrize("state", [nothing, a_light, one_mesh, edit_mode, work_in_a_window])
def test_disabled_operators_give_a_reason(state, monkeypatch):
    monkeypatch.setattr(activity, "running", None)
    state()
    refused = [operator for operator in operators().values() if not operator.poll()]
    assert refused
    for operator in refused:
        with pytest.raises(RuntimeError, match=r"\.poll\(\) ") as refusal:
            operator()
        assert "context is incorrect" not in str(refusal.value), str(refusal.value)


def test_every_operator_is_in_a_menu_so_that_it_is_found_by_searching():
    found = []
    made = creature(1500, seed=1, bend=0.9).surface
    activate(from_pydata("Body", made.vertices.tolist(), made.triangles.tolist()))
    assert bpy.ops.zoomout.detect_symmetry() == {"FINISHED"}  # each that is found can be chosen
    for menu in menus.CLASSES:
        layout = Layout([])
        menu.draw(SimpleNamespace(layout=layout), Context())
        found += layout.operators
    hidden = {
        "zoomout.append_source",
        "zoomout.choose_data",
        "zoomout.add_match_preset",
        "zoomout.add_transfer_preset",
    }  # of panels
    assert set(found) == {f"zoomout.{name}" for name in operators()} - hidden


def test_the_manifest_is_valid():
    tool = Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    package = Path(blender_addon.__file__).parent
    done = subprocess.run([sys.executable, str(tool), "validate", str(package)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
