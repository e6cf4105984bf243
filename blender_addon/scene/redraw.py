# SPDX-License-Identifier: GPL-3.0-or-later
"""Having the 3D views drawn anew, when what they show has changed."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from bpy.types import Area


def redraw_views() -> None:
    """All of them, with their sidebars."""
    for area in _views():
        area.tag_redraw()


def redraw_sidebars() -> None:
    """Their sidebars alone, which is quick."""
    for area in _views():
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


def _views() -> Iterator[Area]:
    for window in bpy.context.window_manager.windows:
        yield from (area for area in window.screen.areas if area.type == "VIEW_3D")
