# SPDX-License-Identifier: GPL-3.0-or-later
"""pymeshlab and bpy live in one process only if bpy comes first, so here it comes first wherever it is installed.

pytest runs this before it imports any test of this folder, whatever other folders it was given, and in which
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
