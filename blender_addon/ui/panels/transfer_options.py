# SPDX-License-Identifier: GPL-3.0-or-later
"""Subpanels of the transfer: blending, naming, and cutting along seams."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...operators.matching.cut_seams import ZOOMOUT_OT_cut_seams
from ...properties.transfer import BLENDING, NAMING
from ...viewport import preview
from .sidebar import SidebarPanel, explain_hidden_preview, preview_buttons, split_properties
from .transfer import ZOOMOUT_PT_transfer


class ZOOMOUT_PT_blending(SidebarPanel, Panel):
    bl_label = "Blending"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 10

    def draw(self, context: Context) -> None:
        split_properties(self.layout)
        settings, target = context.scene.zoomout, context.active_object
        for name in BLENDING:
            if name == "mask_group" and target:
                self.layout.prop_search(settings, name, target, "vertex_groups")
            else:
                self.layout.prop(settings, name)


class ZOOMOUT_PT_naming(SidebarPanel, Panel):
    bl_label = "Groups and Attributes"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 20

    def draw(self, context: Context) -> None:
        split_properties(self.layout)
        for name in NAMING:
            self.layout.prop(context.scene.zoomout, name)


class ZOOMOUT_PT_topology(SidebarPanel, Panel):
    bl_label = "Topology"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 30

    def draw(self, context: Context) -> None:
        of_cut = {preview.CUT: preview.OF_MATCH[preview.CUT]}
        preview_buttons(context, self.layout, of_cut)
        explain_hidden_preview(context, self.layout, of_cut)
        self.layout.operator(ZOOMOUT_OT_cut_seams.bl_idname)
