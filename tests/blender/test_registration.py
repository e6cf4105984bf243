"""The add-on comes and goes, and is a valid extension."""

import subprocess
import sys
from pathlib import Path

import bpy

import blender_addon


def traces():
    names = {name for name in dir(bpy.types) if "zoomout" in name.lower()}
    names |= {f"zoomout.{name}" for name in dir(bpy.ops.zoomout)}
    names |= {f"Scene.{prop.identifier}" for prop in bpy.types.Scene.bl_rna.properties if "zoomout" in prop.identifier}
    handlers = {
        name: len(getattr(bpy.app.handlers, name))
        for name in dir(bpy.app.handlers)
        if isinstance(getattr(bpy.app.handlers, name), list)
    }
    return names, hasattr(bpy.types.Scene, "zoomout"), handlers


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


def test_every_option_and_operator_explains_itself():
    settings = bpy.types.Scene.bl_rna.properties["zoomout"].fixed_type.properties
    for name in dir(bpy.ops.zoomout):
        operator = getattr(bpy.ops.zoomout, name).get_rna_type()
        assert operator.description
        for option in (*operator.properties, *settings):
            assert option.description or option.identifier in ("rna_type", "name"), option.identifier


def test_the_manifest_is_valid():
    tool = Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    package = Path(blender_addon.__file__).parent
    done = subprocess.run([sys.executable, str(tool), "validate", str(package)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
