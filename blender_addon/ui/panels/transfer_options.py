# SPDX-License-Identifier: GPL-3.0-or-later
"""Subpanels of the transfer: binding, blending, naming, and cutting along seams."""

from __future__ import annotations

from bpy.types import Context, Panel

from ...mesh_data import armatures_of
from ...operators.bind_to_rig import ZOOMOUT_OT_bind_to_rig
from ...operators.cut_seams import ZOOMOUT_OT_cut_seams
from ...operators.select_faults import ZOOMOUT_OT_select_stretched
from ...properties.transfer import BLENDING, NAMING, BindOptions
from ...services.preflight import likely_source
from .sidebar import SidebarPanel, split_properties
from .transfer import ZOOMOUT_PT_transfer


class ZOOMOUT_PT_binding(SidebarPanel, Panel):
    bl_label = "Bind to Rig"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_order = 5

    def draw_header(self, context: Context) -> None:
        self.layout.prop(context.scene.zoomout, "bind", text="")

    def draw(self, context: Context) -> None:
        split_properties(self.layout)
        for name in BindOptions.__annotations__:
            self.layout.prop(context.scene.zoomout, name)
        source = likely_source(context) if context.active_object else None
        row = self.layout.row()
        row.enabled = source is not None and bool(armatures_of(source))
        row.operator(ZOOMOUT_OT_bind_to_rig.bl_idname, icon="ARMATURE_DATA")
        self.layout.operator(ZOOMOUT_OT_select_stretched.bl_idname, icon="RESTRICT_SELECT_OFF")


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
        self.layout.operator(ZOOMOUT_OT_cut_seams.bl_idname)
