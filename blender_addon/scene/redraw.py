# SPDX-License-Identifier: GPL-3.0-or-later
"""Redrawing the 3D views when their content has changed."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from bpy.types import Area


def redraw_views() -> None:
    """Redraw all 3D views, with their sidebars."""
    for area in _views():
        area.tag_redraw()


def redraw_sidebars() -> None:
    """Redraw only the sidebars, which is quick."""
    for area in _views():
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


def _views() -> Iterator[Area]:
    for window in bpy.context.window_manager.windows:
        yield from (area for area in window.screen.areas if area.type == "VIEW_3D")
