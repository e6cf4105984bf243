"""The panel to match."""

from __future__ import annotations

from bpy.types import Context, Panel

from .. import stored_match
from ..operators.match import ZOOMOUT_OT_match
from ..properties.match import EVIDENCE, NEARNESS
from .sidebar import SidebarPanel, sentences


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
            sentences(context, box, [f"Matched with '{kept['source']}'; {doubtful}", *kept["notes"]])
