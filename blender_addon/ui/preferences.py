# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's section in Blender's preferences: how to begin, and the news of updates."""

from __future__ import annotations

from bpy.types import AddonPreferences, Context

from . import manual

# The extension's package, by which Blender identifies its preferences.
EXTENSION = __package__.removesuffix(".ui")


class ZOOMOUT_AP_preferences(AddonPreferences):
    bl_idname = EXTENSION

    def draw(self, context: Context) -> None:
        self.layout.label(text="In the sidebar of the 3D Viewport, on the ZoomOut tab")
        row = self.layout.row()
        row.operator("wm.url_open", text="Guide", icon="HELP").url = manual.address(manual.GUIDE)
        row.operator("wm.url_open", text="What's New", icon="INFO").url = manual.address(manual.NEWS)


CLASSES = (ZOOMOUT_AP_preferences,)
