# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of a mesh's own symmetry, and subpanels of the work along it."""

from __future__ import annotations

from typing import Any

from bpy.types import Context, Object, Panel, UILayout

from zoomout_core.messages import message

from ... import services
from ...operators import symmetry as operators
from ...properties.symmetry import KINDS_OF_DATA, ZOOMOUT_PG_symmetry
from ...storage import stored_symmetry
from ...translations import translated
from ...viewport import preview
from .. import manual
from ..thumbnails import icon_of_symmetry
from .sidebar import (
    SidebarPanel,
    draw_notes,
    explain_hidden_preview,
    help_button,
    main_button,
    preview_buttons,
    sentences,
    show_findings,
    split_properties,
)

EDITED = "The mesh was edited after detection: detect its symmetry again."
RESHAPED = "The mesh was reshaped after detection: use Mirror Sculpt to mirror the changes, or detect again."
FEW = "The mesh has few vertices: if a symmetry is missing, subdivide it and detect again."
# Number of thumbnails in a row.
COLUMNS = 2
# Size of the thumbnails, in icons.
PICTURE = 3.2


class ZOOMOUT_PT_symmetry(SidebarPanel, Panel):
    bl_label = "Symmetry"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, context: Context) -> None:
        help_button(self.layout, manual.GUIDE)

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout.symmetry
        split_properties(layout)
        layout.prop(settings, "left")
        stored, target = _description(context), context.active_object
        if target is None or target.type != "MESH":
            sentences(context, layout, ["Make a mesh active."], "INFO")
        else:
            show_findings(context, layout, _doubts(target))
        again = "Detect Symmetry" if stored is None else "Detect Again"
        main_button(layout, operators.ZOOMOUT_OT_detect_symmetry.bl_idname, again, "MOD_MIRROR", True)
        if stored is None:
            return
        if stored_symmetry.is_outdated(target.data, stored):
            show_findings(context, layout, [services.preflight.Finding(EDITED, True)])
            return
        if services.preflight.is_reshaped(target, stored):
            show_findings(context, layout, [services.preflight.Finding(RESHAPED, False)])
        _draw_candidates(context, layout, stored)
        preview_buttons(context, layout, preview.OF_SYMMETRY)
        layout.prop(settings, "check", text="Compare")
        layout.prop(settings, "red_weight" if settings.check == "WEIGHTS" else "red_length")
        layout.prop(settings, "direction")
        explain_hidden_preview(context, layout, preview.OF_SYMMETRY)


class SymmetrySubpanel(SidebarPanel):
    """The base of the symmetry's subpanels."""

    layout: UILayout  # of the panel
    bl_parent_id = "ZOOMOUT_PT_symmetry"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active mesh has a symmetry to work along."""
        stored = _description(context)
        return stored is not None and not stored_symmetry.is_outdated(context.active_object.data, stored)

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout.symmetry
        split_properties(layout)
        self.draw_options(layout, settings)

    def draw_options(self, layout: UILayout, settings: ZOOMOUT_PG_symmetry) -> None:
        """Draw options and operators of one kind of data."""
        raise NotImplementedError


class ZOOMOUT_PT_symmetry_weights(SymmetrySubpanel, Panel):
    bl_label = "Weights"

    def draw_options(self, layout: UILayout, settings: ZOOMOUT_PG_symmetry) -> None:
        layout.prop(settings, "only_active")
        layout.operator(operators.ZOOMOUT_OT_symmetrise_weights.bl_idname)


class ZOOMOUT_PT_symmetry_keys(SymmetrySubpanel, Panel):
    bl_label = "Shape Keys"

    def draw_options(self, layout: UILayout, settings: ZOOMOUT_PG_symmetry) -> None:
        layout.prop(settings, "key_mode")
        if settings.key_mode == "SPLIT":
            layout.prop(settings, "blend")
        layout.operator(operators.ZOOMOUT_OT_mirror_shape_key.bl_idname, text="Mirror Shape Key")


class ZOOMOUT_PT_symmetry_attributes(SymmetrySubpanel, Panel):
    bl_label = "UVs, Colors, Marks"

    def draw_options(self, layout: UILayout, settings: ZOOMOUT_PG_symmetry) -> None:
        column = layout.column(heading="Mirror")
        for name in KINDS_OF_DATA:
            column.prop(settings, name)
        row = layout.row()
        row.enabled = settings.uv_maps
        row.prop(settings, "uv_layout")
        layout.operator(operators.ZOOMOUT_OT_mirror_attributes.bl_idname)


class ZOOMOUT_PT_symmetry_shape(SymmetrySubpanel, Panel):
    bl_label = "Sculpt and Sides"

    def draw_options(self, layout: UILayout, settings: ZOOMOUT_PG_symmetry) -> None:
        layout.operator(operators.ZOOMOUT_OT_mirror_sculpt.bl_idname)
        layout.operator(operators.ZOOMOUT_OT_select_symmetry_line.bl_idname)
        layout.prop(settings, "middle_width")
        layout.operator(operators.ZOOMOUT_OT_name_sides.bl_idname)


# In the order of registration.
CLASSES = (
    ZOOMOUT_PT_symmetry,
    ZOOMOUT_PT_symmetry_weights,
    ZOOMOUT_PT_symmetry_keys,
    ZOOMOUT_PT_symmetry_attributes,
    ZOOMOUT_PT_symmetry_shape,
)


def _doubts(target: Object) -> list[services.preflight.Finding]:
    """Doubts for the user before detecting a mesh's symmetry."""
    few = [FEW] if len(target.data.vertices) < services.preflight.FEW_VERTICES else []
    halves = [modifier.name for modifier in target.modifiers if modifier.type == "MIRROR" and modifier.show_viewport]
    half = "The modifier '{modifier}' creates the other half of the mesh: apply it first."
    texts = [*few, *(message(half, modifier=name) for name in halves)]
    return [services.preflight.Finding(text, False) for text in texts]


def _draw_candidates(context: Context, layout: UILayout, stored: dict[str, Any]) -> None:
    """Draw a thumbnail and a button for each symmetry found, the chosen one pressed, and its notes."""
    grid = layout.grid_flow(row_major=True, columns=COLUMNS, even_columns=True, align=True)
    pictures = stored_symmetry.thumbnails(stored)
    for number, candidate in enumerate(stored["candidates"]):
        column = grid.column(align=True)
        if pictures:
            column.template_icon(icon_of_symmetry(*pictures[number]), scale=PICTURE)
        chosen = number == stored["chosen"]
        button = column.operator(
            operators.ZOOMOUT_OT_choose_symmetry.bl_idname,
            text=translated(stored_symmetry.summary(candidate)),
            depress=chosen,
        )
        button.number = number
    candidate = stored["candidates"][stored["chosen"]]
    if candidate["sides"]:
        layout.operator(operators.ZOOMOUT_OT_swap_sides.bl_idname, text="Swap Sides", icon="ARROW_LEFTRIGHT")
    draw_notes(context, layout, candidate["notes"])


def _description(context: Context) -> dict[str, Any] | None:
    obj = context.active_object
    return stored_symmetry.description(obj.data) if obj and obj.type == "MESH" else None
