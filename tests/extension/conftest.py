"""Tests of the installed zip, for environments of Blender and pytest alone: `tools/blender_versions.py` runs them.

`ZOOMOUT_EXTENSION` names the zip; without it there is nothing here to collect. Blender's own folders are empty ones.
"""

import os
import tempfile

collect_ignore_glob = [] if "ZOOMOUT_EXTENSION" in os.environ else ["test_*"]
if "ZOOMOUT_EXTENSION" in os.environ:
    os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp()
    import bpy  # noqa: F401  reads the variable, and makes Blender's other modules known
