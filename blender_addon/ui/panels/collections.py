# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of characters of several objects."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...operators.matching.match_collections import ZOOMOUT_OT_match_collections
from ...properties.collections import CollectionSettings
from .sidebar import SidebarPanel, split_properties


class ZOOMOUT_PT_collections(SidebarPanel, Panel):
    bl_label = "Collections"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Context) -> None:
        layout = self.layout
        split_properties(layout)
        for name in CollectionSettings.__annotations__:
            layout.prop(context.scene.zoomout, name)
        layout.operator(ZOOMOUT_OT_match_collections.bl_idname)
