# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel that finds a source in libraries."""

from __future__ import annotations

from pathlib import Path

from bpy.types import Context, Panel

from ... import services
from ...operators.find_source import ZOOMOUT_OT_append_source, ZOOMOUT_OT_find_source
from ...properties.library import LibrarySettings
from ..thumbnails import icon_of_file, icon_of_picture
from .sidebar import SidebarPanel, split_properties

# Scale of pictures.
PICTURE = 4.0


class ZOOMOUT_PT_library(SidebarPanel, Panel):
    bl_label = "Libraries"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout
        split_properties(layout)
        for name in LibrarySettings.__annotations__:
            layout.prop(settings, name)
        layout.operator(ZOOMOUT_OT_find_source.bl_idname, icon="VIEWZOOM")
        obj = context.active_object
        if obj is None or obj.name != settings.found_for:
            return
        for found in settings.found_sources:
            column = layout.column(align=True)
            pictures = [
                icon_of_picture(image) for image in services.found_pictures.last_pictures.get(Path(found.name), ())
            ]
            row = column.row()
            for picture in (icon_of_file(found.name), *pictures):
                if picture is not None:
                    row.template_icon(picture, scale=PICTURE)
            icon = "CHECKMARK" if found.fits else "CANCEL"
            column.operator(
                ZOOMOUT_OT_append_source.bl_idname, text=found.line, icon=icon, translate=False
            ).path = found.name
        if settings.found_part:
            column = layout.column(align=True)
            column.label(text="Better for a part, after the first:")
            operator = column.operator(
                ZOOMOUT_OT_append_source.bl_idname, text=settings.found_part_line, icon="GROUP_VERTEX", translate=False
            )
            operator.path, operator.joints = settings.found_part, settings.found_part_joints
