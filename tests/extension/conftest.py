"""Tests of the installed zip, for environments of Blender and pytest alone: `tools/blender_versions.py` runs them.

`ZOOMOUT_EXTENSION` names the zip; without it there is nothing here to collect. Blender's own folders are empty ones.
"""

import os
import shutil
import sys
import tempfile

collect_ignore_glob = ["test_*"]

if "ZOOMOUT_EXTENSION" in os.environ:
    collect_ignore_glob = []
    user_folder = os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp()
    import bpy  # noqa: F401  reads the variable, and makes Blender's other modules known

    exit_status = 1

    def pytest_sessionfinish(session, exitstatus):
        global exit_status
        exit_status = int(exitstatus)

    def pytest_unconfigure(config):
        """End at once: where an add-on was registered, the module of Blender 4.2 crashes at its exit,
        for it frees classes after Python has gone.
        """
        shutil.rmtree(user_folder)
        sys.stdout.flush()
        os._exit(exit_status)
