# SPDX-License-Identifier: GPL-3.0-or-later
"""The subpanel of baking textures."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...operators.bake_textures import ZOOMOUT_OT_bake_textures
from ...scene.selection import match_source
from .sidebar import SidebarPanel, split_properties
from .transfer import ZOOMOUT_PT_transfer


class ZOOMOUT_PT_bake(SidebarPanel, Panel):
    bl_label = "Bake Textures"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 6

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active mesh was matched."""
        return bool(match_source(context, context.active_object))

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout
        split_properties(layout)
        layout.prop(settings, "bake_size")
        layout.prop_search(settings, "bake_uv_map", context.active_object.data, "uv_layers")
        layout.prop(settings, "bake_relief")
        layout.prop(settings, "bake_save")
        layout.operator(ZOOMOUT_OT_bake_textures.bl_idname, icon="TEXTURE")
