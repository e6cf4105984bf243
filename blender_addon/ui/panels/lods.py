# SPDX-License-Identifier: GPL-3.0-or-later
"""The subpanel of levels of detail."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...operators.make_lods import ZOOMOUT_OT_make_lods
from .sidebar import SidebarPanel, split_properties
from .transfer import ZOOMOUT_PT_transfer


class ZOOMOUT_PT_lods(SidebarPanel, Panel):
    bl_label = "Levels of Detail"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 7

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout
        split_properties(layout)
        layout.prop(settings, "lod_source")
        if settings.lod_source == "RATIOS":
            layout.prop(settings, "lod_count")
            layout.prop(settings, "lod_ratio")
        else:
            layout.prop(settings, "lod_keep_uv")
        layout.prop(settings, "lod_max_weights")
        layout.operator(ZOOMOUT_OT_make_lods.bl_idname, icon="MOD_DECIM")
