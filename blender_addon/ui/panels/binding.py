# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of binding a mesh to the source's armature, and of checking the result."""

from __future__ import annotations

from bpy.types import Context, Panel

from ... import services
from ...mesh_data import armatures_of
from ...operators.bind_to_rig import ZOOMOUT_OT_bind_to_rig
from ...operators.check_motion import ZOOMOUT_OT_check_motion
from ...operators.matching.select_faults import ZOOMOUT_OT_select_stretched
from ...operators.move_rig import ZOOMOUT_OT_move_rig
from ...operators.play_test_poses import ZOOMOUT_OT_test_poses
from ...properties.transfer import BindOptions, BindView
from ...viewport.preview import OF_BINDING
from .sidebar import SidebarPanel, explain_hidden_preview, preview_buttons, split_properties


class ZOOMOUT_PT_binding(SidebarPanel, Panel):
    bl_label = "Bind to Rig"

    def draw_header(self, context: Context) -> None:
        self.layout.prop(context.scene.zoomout, "bind", text="")

    def draw(self, context: Context) -> None:
        split_properties(self.layout)
        for name in (*BindOptions.__annotations__, *BindView.__annotations__):
            self.layout.prop(context.scene.zoomout, name)
        source = services.preflight.likely_source(context) if context.active_object else None
        row = self.layout.row(align=True)
        row.enabled = source is not None
        bind = row.row(align=True)
        bind.enabled = source is not None and bool(armatures_of(source))
        bind.operator(ZOOMOUT_OT_bind_to_rig.bl_idname, icon="ARMATURE_DATA")
        row.operator(ZOOMOUT_OT_move_rig.bl_idname, icon="OUTLINER_OB_ARMATURE")


class ZOOMOUT_PT_binding_check(SidebarPanel, Panel):
    bl_label = "Check Binding"
    bl_parent_id = ZOOMOUT_PT_binding.__name__
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Context) -> None:
        layout = self.layout
        layout.operator(ZOOMOUT_OT_test_poses.bl_idname, icon="POSE_HLT")
        layout.operator(ZOOMOUT_OT_check_motion.bl_idname, icon="ACTION")
        layout.operator(ZOOMOUT_OT_select_stretched.bl_idname, icon="RESTRICT_SELECT_OFF")
        enabled = ZOOMOUT_OT_select_stretched.poll(context)
        preview_buttons(context, layout, OF_BINDING, enabled)
        explain_hidden_preview(context, layout, OF_BINDING)
