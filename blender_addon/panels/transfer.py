"""The panel to transfer."""

from __future__ import annotations

from bpy.types import Context, Panel

from ..operators.cut_seams import ZOOMOUT_OT_cut_seams
from ..operators.transfer import ZOOMOUT_OT_transfer, summary
from ..properties.transfer import BlendOptions, TransferOptions
from ..stored_report import transfer_report
from .sidebar import SidebarPanel, sentences


class ZOOMOUT_PT_transfer(SidebarPanel, Panel):
    bl_label = "Transfer"

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout
        column = layout.column(align=True)
        for name in TransferOptions.__annotations__:
            column.prop(settings, name)
        target = context.active_object
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        for name in BlendOptions.__annotations__:
            if name == "mask_group" and target:
                column.prop_search(settings, name, target, "vertex_groups")
            else:
                column.prop(settings, name)
        layout.operator(ZOOMOUT_OT_transfer.bl_idname)
        layout.operator(ZOOMOUT_OT_cut_seams.bl_idname)
        report = transfer_report(target) if target and target.type == "MESH" else None
        if report is not None:
            skipped = [f"{name}: skipped, {reason}" for name, reason in report["skipped"].items()]
            sentences(context, layout.box(), [summary(report), *skipped, *report["notes"]])
