# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's section in Blender's preferences: first steps, release notes, and work done ahead."""

from __future__ import annotations

from bpy.types import AddonPreferences, Context

from ..properties.preferences import EXTENSION, AheadPreferences
from . import manual


class ZOOMOUT_AP_preferences(AheadPreferences, AddonPreferences):
    bl_idname = EXTENSION

    def draw(self, context: Context) -> None:
        self.layout.label(text="In the sidebar of the 3D Viewport, on the ZoomOut tab")
        row = self.layout.row()
        row.operator("wm.url_open", text="Guide", icon="HELP").url = manual.address(manual.GUIDE)
        row.operator("wm.url_open", text="What's New", icon="INFO").url = manual.address(manual.NEWS)
        self.layout.prop(self, "prepare_ahead")


CLASSES = (ZOOMOUT_AP_preferences,)
