# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the results of the last search in libraries."""

from __future__ import annotations

from pathlib import Path

from zoomout_core.arrays import Bytes

# The pictures of the last search by file, which the sidebar shows until Blender ends.
last_pictures: dict[Path, tuple[Bytes, Bytes]] = {}
