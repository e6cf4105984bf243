"""The panel to match: who is matched, how, what stands in the way, and the button."""

from __future__ import annotations

from bpy.types import Context, Object, Panel, UILayout

from .. import stored_match
from ..operators.match import ZOOMOUT_OT_match
from ..preflight import findings, likely_source
from .sidebar import SidebarPanel, main_button, show_findings, split_properties


class ZOOMOUT_PT_match(SidebarPanel, Panel):
    bl_label = "Match"

    def draw(self, context: Context) -> None:
        layout, settings, target = self.layout, context.scene.zoomout, context.active_object
        split_properties(layout)
        column = layout.column()
        column.prop(settings, "source")
        is_mesh = target is not None and target.type == "MESH"
        if settings.source is None and is_mesh and (source := likely_source(context)):
            _object_row(column, "", source, "(selected)")
        _object_row(column, "Target", target if is_mesh else None, "(active)")
        layout.prop(settings, "initial")
        if settings.initial == "FILE":
            layout.prop(settings, "map_file")
        if settings.initial not in ("NEAREST", "SAME_ORDER"):
            row = layout.row(align=True)
            row.use_property_split = False  # the three need all the width
            row.prop(settings, "detail", expand=True)
        found = findings(context)
        show_findings(context, layout, found)
        again = is_mesh and stored_match.description(target.data) is not None
        main_button(
            layout,
            ZOOMOUT_OT_match.bl_idname,
            "Match Again" if again else "Match",
            "VIEWZOOM",
            not any(finding.blocks for finding in found),
        )


def _object_row(layout: UILayout, label: str, obj: Object | None, role: str) -> None:
    """An object that was chosen elsewhere, in the place of a property."""
    split = layout.split(factor=0.4)
    name = split.row()
    name.alignment = "RIGHT"
    name.label(text=label)
    split.label(text=f"{obj.name} {role}" if obj else "None", icon="OUTLINER_OB_MESH" if obj else "BLANK1")
