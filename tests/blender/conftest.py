import os
import tempfile

import pytest

# Wheels of extensions that this machine's user has installed would shadow the environment's packages.
os.environ.setdefault("BLENDER_USER_EXTENSIONS", tempfile.mkdtemp())

import bpy

import blender_addon


@pytest.fixture(autouse=True)
def empty_scene():
    """An empty factory scene, with the add-on."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    blender_addon.register()
    yield bpy.context.scene
    blender_addon.unregister()
