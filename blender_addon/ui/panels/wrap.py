# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of wrapping one mesh onto the other."""

from __future__ import annotations

from bpy.types import Context, Panel

from ... import services
from ...operators.wrap import ZOOMOUT_OT_wrap
from ...properties.wrap import WrapOptions
from .sidebar import SidebarPanel, split_properties


class ZOOMOUT_PT_wrap(SidebarPanel, Panel):
    bl_label = "Wrap"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Context) -> None:
        layout, settings, target = self.layout, context.scene.zoomout, context.active_object
        split_properties(layout)
        source = services.preflight.likely_source(context) if target else None
        wrapped = source if settings.wrap_reverse else target
        for name in WrapOptions.__annotations__:
            if name == "wrap_mask" and wrapped:
                layout.prop_search(settings, name, wrapped, "vertex_groups")
            else:
                layout.prop(settings, name)
        row = layout.row()
        row.enabled = source is not None
        row.operator(ZOOMOUT_OT_wrap.bl_idname, icon="MOD_SHRINKWRAP")
