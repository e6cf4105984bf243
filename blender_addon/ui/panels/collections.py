# SPDX-License-Identifier: GPL-3.0-or-later
"""Subpanel of the match: characters of several objects."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...operators.match_collections import ZOOMOUT_OT_match_collections
from ...properties.collections import CollectionSettings
from .match import ZOOMOUT_PT_match
from .sidebar import SidebarPanel, split_properties


class ZOOMOUT_PT_collections(SidebarPanel, Panel):
    bl_label = "Collections"
    bl_parent_id = ZOOMOUT_PT_match.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 25

    def draw(self, context: Context) -> None:
        layout = self.layout
        split_properties(layout)
        for name in CollectionSettings.__annotations__:
            layout.prop(context.scene.zoomout, name)
        layout.operator(ZOOMOUT_OT_match_collections.bl_idname)
