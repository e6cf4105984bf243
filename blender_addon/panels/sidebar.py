"""What the panels of the sidebar have in common."""

from __future__ import annotations

import textwrap

from bpy.types import Context, UILayout

# Width of a letter and of the border around a panel's text, in pixels at the interface's normal scale.
LETTER, BORDER = 6, 40


class SidebarPanel:
    """What the panels have in common."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ZoomOut"


def sentences(context: Context, layout: UILayout, texts: list[str]) -> None:
    """Text, broken into lines that fit the panel."""
    scale = context.preferences.system.ui_scale
    letters = max(20, int((context.region.width / scale - BORDER) / LETTER))
    for text in texts:
        column = layout.column(align=True)
        for line in textwrap.wrap(text, letters):
            column.label(text=line)
