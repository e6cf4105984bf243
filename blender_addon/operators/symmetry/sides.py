# SPDX-License-Identifier: GPL-3.0-or-later
"""Select the symmetry line of the active mesh, and name its sides by vertex groups."""

from __future__ import annotations

from bpy.types import Context

from zoomout_core.runtime.progress import stage

from ... import services
from ...jobs import pause
from ...properties.settings import take_settings
from ...properties.symmetry import LEFT_GROUP, MIDDLE_GROUP, RIGHT_GROUP, SideOptions
from .base import SymmetryOperator


class ZOOMOUT_OT_select_symmetry_line(SymmetryOperator):
    bl_idname = "zoomout.select_symmetry_line"
    bl_label = "Select Symmetry Line"
    bl_description = "Select the vertices and edges nearest to the line between left and right"
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        obj = services.symmetry.mesh_access.writable_mesh(context, context.active_object.name)
        with stage("Selecting"):
            await pause()
        result = services.symmetry.sides.select_symmetry_line(obj)
        if not context.tool_settings.mesh_select_mode[0]:  # other modes would deselect vertices
            context.tool_settings.mesh_select_mode = (True, False, False)
        return result


class ZOOMOUT_OT_name_sides(SideOptions, SymmetryOperator):
    bl_idname = "zoomout.name_sides"
    bl_label = "Name Sides"
    bl_description = (
        "Create vertex groups for the left side, the right side and the middle: "
        f"{LEFT_GROUP}, {RIGHT_GROUP}, {MIDDLE_GROUP}"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        obj = services.symmetry.mesh_access.writable_mesh(context, context.active_object.name)
        with stage("Naming"):
            await pause()
        return services.symmetry.sides.name_sides(obj, self.middle_width)
