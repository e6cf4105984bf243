# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the symmetries of the active mesh, store them on it, and choose among them."""

from __future__ import annotations

from bpy.props import IntProperty
from bpy.types import Context

from zoomout_core.runtime.progress import stage

from ... import services
from ...jobs import pause
from ...properties.once import ONCE
from ...properties.settings import take_settings
from ...properties.symmetry import DetectOptions
from ..base.modal_operator import ModalOperator
from .base import SymmetryOperator


class ZOOMOUT_OT_detect_symmetry(DetectOptions, ModalOperator):
    bl_idname = "zoomout.detect_symmetry"
    bl_label = "Detect Symmetry"
    bl_description = (
        "Find the symmetries of the active mesh, in any pose and topology. They are stored on the mesh and used by "
        "the tools below"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        name = context.active_object.name
        found = await services.symmetry.detect.detect_symmetry_async(context, name, self.left, show_preview=True)
        return services.symmetry.detect.found_summary(name, found)


class ZOOMOUT_OT_choose_symmetry(SymmetryOperator):
    bl_idname = "zoomout.choose_symmetry"
    bl_label = "Use Symmetry"
    bl_description = "Use this one of the detected symmetries of the active mesh"
    bl_options = {"REGISTER", "UNDO"}

    number: IntProperty(
        name="Number", description="Number of the symmetry, starting at 0", min=0, default=0, options=ONCE
    )

    async def work(self, context: Context) -> str:
        obj = services.symmetry.mesh_access.writable_mesh(context, context.active_object.name)
        with stage("Choosing"):
            await pause()
        return services.symmetry.detect.choose_symmetry(context, obj, self.number)


class ZOOMOUT_OT_swap_sides(SymmetryOperator):
    bl_idname = "zoomout.swap_sides"
    bl_label = "Swap Sides of Symmetry"
    bl_description = "Swap left and right of the chosen symmetry, if the axis assigned them the wrong way round"
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        obj = services.symmetry.mesh_access.writable_mesh(context, context.active_object.name)
        with stage("Swapping"):
            await pause()
        return services.symmetry.detect.swap_sides(context, obj)
