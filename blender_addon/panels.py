"""The sidebar of the 3D view."""

from __future__ import annotations

import textwrap

from bpy.types import Context, Panel, UILayout

from . import stored_match
from .operators.cut_seams import ZOOMOUT_OT_cut_seams
from .operators.match import ZOOMOUT_OT_match
from .operators.transfer import ZOOMOUT_OT_transfer, summary
from .properties import EVIDENCE, NEARNESS, BlendOptions, TransferOptions
from .stored_report import transfer_report

# Width of a letter and of the border around a panel's text, in pixels at the interface's normal scale.
LETTER, BORDER = 6, 40


class SidebarPanel:
    """What the panels have in common."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ZoomOut"


class ZOOMOUT_PT_match(SidebarPanel, Panel):
    bl_label = "Match"

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "source")
        layout.prop(settings, "initial")
        if settings.initial == "NEAREST":
            for name in NEARNESS:
                layout.prop(settings, name)
        else:
            layout.prop(settings, "k_final")
            evidence = layout.column(heading="Evidence")
            evidence.enabled = settings.initial == "AUTO"
            for name in EVIDENCE:
                evidence.prop(settings, name)
        layout.operator(ZOOMOUT_OT_match.bl_idname)
        target = context.active_object
        kept = stored_match.description(target.data) if target and target.type == "MESH" else None
        if kept is not None:
            box = layout.box()
            doubtful = f"{kept['low_confidence']} of {kept['vertices']} vertices are of low confidence"
            _sentences(context, box, [f"Matched with '{kept['source']}'; {doubtful}", *kept["notes"]])


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
            _sentences(context, layout.box(), [summary(report), *skipped, *report["notes"]])


def _sentences(context: Context, layout: UILayout, sentences: list[str]) -> None:
    """Text, broken into lines that fit the panel."""
    scale = context.preferences.system.ui_scale
    letters = max(20, int((context.region.width / scale - BORDER) / LETTER))
    for sentence in sentences:
        column = layout.column(align=True)
        for line in textwrap.wrap(sentence, letters):
            column.label(text=line)
