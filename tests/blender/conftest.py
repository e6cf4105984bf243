import os
import tempfile

import pytest

# Wheels of extensions that this machine's user has installed would shadow the environment's packages.
os.environ.setdefault("BLENDER_USER_EXTENSIONS", tempfile.mkdtemp())

import bpy
from scenes import activate, ellipsoid

import blender_addon


@pytest.fixture(autouse=True)
def empty_scene():
    """An empty factory scene, with the add-on."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    blender_addon.register()
    yield bpy.context.scene
    blender_addon.unregister()


@pytest.fixture
def source():
    """A mesh to read from."""
    return ellipsoid("Source", 4)


@pytest.fixture
def target(source):
    """The same once more, active, with the source selected besides."""
    obj = ellipsoid("Target", 4)
    bpy.context.view_layer.update()
    activate(obj, source)
    return obj
