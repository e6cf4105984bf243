# SPDX-License-Identifier: GPL-3.0-or-later
import os
import tempfile

import pytest

# Wheels of extensions that this machine's user has installed would shadow the environment's packages.
os.environ.setdefault("BLENDER_USER_EXTENSIONS", tempfile.mkdtemp())

import bpy
import numpy as np
from scenes import activate, ellipsoid
from symmetric import BENT, new_object

import blender_addon
import zoomout_core as zo
from blender_addon.storage import stored_symmetry


@pytest.fixture(scope="module", autouse=True)
def _each_match_once(remember_matches):
    """Matches are computed by the core, and tested there."""


@pytest.fixture(scope="module", autouse=True)
def _factory_settings():
    bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture(autouse=True)
def empty_scene(_factory_settings):
    """An empty factory scene with the add-on. Preferences are reset per module only, since that is six times slower."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    blender_addon.register()
    yield bpy.context.scene
    blender_addon.unregister()


@pytest.fixture
def source():
    """A mesh to read from."""
    return ellipsoid("Source", 4)


@pytest.fixture
def target(source):
    """A copy of it, active, with the source selected as well."""
    obj = ellipsoid("Target", 4)
    bpy.context.view_layer.update()
    activate(obj, source)
    return obj


@pytest.fixture(scope="module")
def found(remember_matches):
    """The symmetries of the posed creature, in Blender's single precision."""
    return zo.detect_symmetry(BENT.surface.with_vertices(BENT.surface.vertices.astype(np.float32)))


@pytest.fixture
def body(found):
    """The posed creature, with a known symmetry."""
    obj = new_object()
    stored_symmetry.write(obj, found, "X")
    activate(obj)
    return obj
