# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the installed zip, for environments with only Blender and pytest: `tools/blender_versions.py` runs them.

`ZOOMOUT_EXTENSION` names the zip; without it nothing is collected here. Blender's user folders are empty.
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
        """End the process at once, to skip the exit of Blender's module after classes were registered.

        The module of 4.2 crashes if a class with a function is still registered, or if a property group was registered:
        `unregister_class` leaks a reference to such a class, which keeps `bpy` alive past the end of Python, and
        Blender frees its types only then. The module of 4.5 hangs for the same reason while a class is registered. Five
        lines without this extension reproduce it, and so does Blender's own Rigify; later versions exit normally.
        """
        shutil.rmtree(user_folder)
        sys.stdout.flush()
        os._exit(exit_status)
