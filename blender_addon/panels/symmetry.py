"""The panel of a mesh's own symmetry, and what is done along it."""

from __future__ import annotations

from typing import Any

from bpy.types import Context, Panel, UILayout

from .. import manual, stored_symmetry, symmetry_preview
from ..operators import symmetry as operators
from ..operators.symmetry.detect import summary
from ..properties.symmetry import KINDS_OF_DATA, ZOOMOUT_PG_symmetry
from .sidebar import SidebarPanel, help_button, sentences


class ZOOMOUT_PT_symmetry(SidebarPanel, Panel):
    bl_label = "Symmetry"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, context: Context) -> None:
        help_button(self.layout, manual.GUIDE)

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout.symmetry
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "left")
        layout.operator(operators.ZOOMOUT_OT_detect_symmetry.bl_idname)
        kept = _kept(context)
        if kept is None:
            return
        mesh = context.active_object.data
        if stored_symmetry.is_outdated(mesh, kept):
            sentences(context, layout.box(), ["The mesh was edited since: detect its symmetry again"])
            return
        _draw_candidates(context, layout.box(), kept)
        layout.prop(settings, "direction")
        row = layout.row(align=True)
        row.operator(operators.ZOOMOUT_OT_preview_symmetry.bl_idname, icon="HIDE_OFF")
        row.operator(operators.ZOOMOUT_OT_remove_preview.bl_idname, text="", icon="X")
        if symmetry_preview.is_shown(mesh):
            sentences(context, layout.box(), [symmetry_preview.shown(mesh)])


class SymmetrySubpanel(SidebarPanel):
    """What the panels below that of the symmetry have in common."""

    layout: UILayout  # of the panel
    bl_parent_id = "ZOOMOUT_PT_symmetry"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active mesh has a symmetry to work along."""
        kept = _kept(context)
        return kept is not None and not stored_symmetry.is_outdated(context.active_object.data, kept)

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout.symmetry
        layout.use_property_split = True
        layout.use_property_decorate = False
        self.draw_options(layout, settings)

    def draw_options(self, layout: UILayout, settings: ZOOMOUT_PG_symmetry) -> None:
        """Options and operators of one kind of data."""
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
        layout.operator(operators.ZOOMOUT_OT_mirror_shape_key.bl_idname)


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


class ZOOMOUT_PT_symmetry_check(SymmetrySubpanel, Panel):
    bl_label = "Check"

    def draw_options(self, layout: UILayout, settings: ZOOMOUT_PG_symmetry) -> None:
        layout.prop(settings, "check")
        layout.operator(operators.ZOOMOUT_OT_check_symmetry.bl_idname)


# In the order in which Blender is to know them.
CLASSES = (
    ZOOMOUT_PT_symmetry,
    ZOOMOUT_PT_symmetry_weights,
    ZOOMOUT_PT_symmetry_keys,
    ZOOMOUT_PT_symmetry_attributes,
    ZOOMOUT_PT_symmetry_shape,
    ZOOMOUT_PT_symmetry_check,
)


def _draw_candidates(context: Context, box: UILayout, kept: dict[str, Any]) -> None:
    """A button for each symmetry that was found, the chosen one marked, and what is to know of it."""
    column = box.column(align=True)
    for number, candidate in enumerate(kept["candidates"]):
        chosen = number == kept["chosen"]
        button = column.operator(
            operators.ZOOMOUT_OT_choose_symmetry.bl_idname,
            text=summary(candidate),
            icon="RADIOBUT_ON" if chosen else "RADIOBUT_OFF",
            depress=chosen,
        )
        button.number = number
    candidate = kept["candidates"][kept["chosen"]]
    if candidate["sides"]:
        box.operator(operators.ZOOMOUT_OT_swap_sides.bl_idname, text="Swap Sides", icon="ARROW_LEFTRIGHT")
    sentences(context, box, candidate["notes"])


def _kept(context: Context) -> dict[str, Any] | None:
    obj = context.active_object
    return stored_symmetry.description(obj.data) if obj and obj.type == "MESH" else None
