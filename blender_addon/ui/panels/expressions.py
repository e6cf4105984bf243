# SPDX-License-Identifier: GPL-3.0-or-later
"""The subpanel of expression keys: whose names they have, renaming, and playing them."""

from __future__ import annotations

from bpy.types import Context, Panel

from zoomout_core.messages import message

from ... import mesh_data, services
from ...operators.play_expressions import ZOOMOUT_OT_play_expressions
from ...operators.rename_shape_keys import ZOOMOUT_OT_rename_shape_keys
from .. import manual
from .sidebar import SidebarPanel, help_button, sentences
from .transfer import ZOOMOUT_PT_transfer

NO_CONVENTION = "The names of the shape keys follow no known convention"


class ZOOMOUT_PT_expressions(SidebarPanel, Panel):
    bl_label = "Expressions"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 4

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active mesh has shape keys."""
        obj = context.active_object
        return obj is not None and obj.type == "MESH" and bool(mesh_data.names_of_keys(obj))

    def draw_header_preset(self, context: Context) -> None:
        help_button(self.layout, manual.GUIDE)

    def draw(self, context: Context) -> None:
        layout = self.layout
        title = services.key_names.convention_of(tuple(mesh_data.names_of_keys(context.active_object)))
        text = message("Shape keys with the names of {title}", title=title) if title else NO_CONVENTION
        sentences(context, layout, [text], "SHAPEKEY_DATA")
        layout.operator(ZOOMOUT_OT_rename_shape_keys.bl_idname)
        layout.operator(ZOOMOUT_OT_play_expressions.bl_idname, icon="PLAY")
