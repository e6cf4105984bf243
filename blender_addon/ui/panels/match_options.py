# SPDX-License-Identifier: GPL-3.0-or-later
"""Subpanels of the match: further hints, and advanced options."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...operators.clear_data import ZOOMOUT_OT_clear_match_data
from ...properties.match import options_of_panel
from .match import ZOOMOUT_PT_match
from .sidebar import SidebarPanel, split_properties


class ZOOMOUT_PT_hints(SidebarPanel, Panel):
    bl_label = "Hints"
    bl_parent_id = ZOOMOUT_PT_match.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 20

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the start uses hints."""
        return context.scene.zoomout.initial == "AUTO"

    def draw(self, context: Context) -> None:
        split_properties(self.layout)
        column = self.layout.column(heading="Consider")
        settings = context.scene.zoomout
        for option in options_of_panel(ZOOMOUT_PT_hints.bl_label, settings.initial):
            column.prop(settings, option.name)


class ZOOMOUT_PT_match_advanced(SidebarPanel, Panel):
    bl_label = "Advanced"
    bl_parent_id = ZOOMOUT_PT_match.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 30

    def draw(self, context: Context) -> None:
        split_properties(self.layout)
        settings = context.scene.zoomout
        for option in options_of_panel(ZOOMOUT_PT_match_advanced.bl_label, settings.initial):
            self.layout.prop(settings, option.name)
        target = context.active_object
        if target is not None and target.type == "MESH":
            row = self.layout.split(factor=0.72, align=True)
            row.prop_search(settings, "redo_group", target, "vertex_groups")
            row.prop(settings, "redo_keeps", toggle=True)
        row = self.layout.row(align=True)
        row.operator(ZOOMOUT_OT_clear_match_data.bl_idname)
        row.operator(ZOOMOUT_OT_clear_match_data.bl_idname, text="Whole File").whole_file = True
