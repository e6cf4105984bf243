# SPDX-License-Identifier: GPL-3.0-or-later
"""The tested zip, and its installation folder in Blender."""

import os
import tomllib
import zipfile
from pathlib import Path

ARCHIVE = Path(os.environ["ZOOMOUT_EXTENSION"])
USER = Path(os.environ["BLENDER_USER_RESOURCES"])

with zipfile.ZipFile(ARCHIVE) as opened:
    MANIFEST = tomllib.loads(opened.read("blender_manifest.toml").decode())
    CONTENT = {name: opened.read(name) for name in opened.namelist() if not name.endswith(".whl")}
    WHEELS = [name for name in opened.namelist() if name.endswith(".whl")]

EXTENSION = f"bl_ext.user_default.{MANIFEST['id']}"
