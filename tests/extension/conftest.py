# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the installed zip, for environments of Blender and pytest alone: `tools/blender_versions.py` runs them.

`ZOOMOUT_EXTENSION` names the zip; without it there is nothing here to collect. Blender's own folders are empty ones.
"""

import importlib
import os
import shutil
import sys
import tempfile

collect_ignore_glob = ["test_*"]

if "ZOOMOUT_EXTENSION" in os.environ:
    collect_ignore_glob = []
    user_folder = os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp()
    import bpy  # reads the variable, and makes Blender's other modules known
    import pytest
    from archive import ARCHIVE, EXTENSION

    exit_status = 1

    @pytest.fixture(scope="session")
    def installed():
        """The extension, installed from the zip and enabled, in an empty file."""
        bpy.ops.wm.read_factory_settings(use_empty=True)
        install = bpy.ops.extensions.package_install_files
        assert install(filepath=str(ARCHIVE), repo="user_default", enable_on_install=True) == {"FINISHED"}
        return importlib.import_module(EXTENSION)

    def pytest_sessionfinish(session, exitstatus):
        global exit_status
        exit_status = int(exitstatus)

    def pytest_unconfigure(config):
        """End at once, for what Blender's own module does at its exit once classes were registered.

        That of 4.2 crashes if a class that has a function is still there, or was there and is one of properties:
        `unregister_class` leaves such a class a reference too many, it keeps `bpy` alive past the end of Python, and
        Blender frees its types only then. That of 4.5 hangs for the same reason while a class is there. Five lines
        without this extension do it, and so does Blender's own Rigify; later versions end well.
        """
        shutil.rmtree(user_folder)
        sys.stdout.flush()
        os._exit(exit_status)
