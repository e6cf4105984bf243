# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of dressing the target with the source's clothes."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...operators.dress import ZOOMOUT_OT_dress
from ...properties.dress import DressOptions
from ...scene.selection import match_source
from .sidebar import SidebarPanel, split_properties


class ZOOMOUT_PT_dress(SidebarPanel, Panel):
    bl_label = "Dress"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout
        split_properties(layout)
        layout.prop(settings, "dress_collection")
        for name in DressOptions.__annotations__:
            layout.prop(settings, name)
        row = layout.row()
        row.enabled = settings.source is not None or bool(match_source(context, context.active_object))
        row.operator(ZOOMOUT_OT_dress.bl_idname, icon="MOD_CLOTH")
