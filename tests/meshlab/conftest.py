# SPDX-License-Identifier: GPL-3.0-or-later
"""Import bpy before pymeshlab if it is installed; in the other order they cannot share a process.

pytest runs this before it imports any test of this folder, independently of other folders and their
order.
"""

import os
import tempfile
from contextlib import suppress

# As in tests/blender: wheels of extensions that this machine's user has installed would shadow the packages here.
os.environ.setdefault("BLENDER_USER_EXTENSIONS", tempfile.mkdtemp())
# Nor do tests keep anything in the cache of this machine's user.
os.environ["ZOOMOUT_CACHE"] = "off"

with suppress(ImportError):
    import bpy  # noqa: F401
