"""Find the symmetries of the active mesh, store them on it, and choose among them."""

from __future__ import annotations

from bpy.props import IntProperty
from bpy.types import Context

from zoomout_core.runtime.progress import stage

from ...jobs import pause
from ...properties.once import ONCE
from ...properties.settings import take_settings
from ...properties.symmetry import DetectOptions
from ...services.symmetry.detect import choose_symmetry, detect_symmetry_async, found_summary, swap_sides
from ...services.symmetry.mesh_access import writable_mesh
from ..modal_operator import ModalOperator
from .base import SymmetryOperator


class ZOOMOUT_OT_detect_symmetry(DetectOptions, ModalOperator):
    bl_idname = "zoomout.detect_symmetry"
    bl_label = "Detect Symmetry"
    bl_description = (
        "Find which places of the active mesh correspond to each other, as left and right do, whatever its pose and "
        "topology. What is found is kept on the mesh, for all that follows"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        name = context.active_object.name
        found = await detect_symmetry_async(context, name, self.left)
        return found_summary(name, found)


class ZOOMOUT_OT_choose_symmetry(SymmetryOperator):
    bl_idname = "zoomout.choose_symmetry"
    bl_label = "Use Symmetry"
    bl_description = "Use this symmetry of the active mesh, of those that were found"
    bl_options = {"REGISTER", "UNDO"}

    number: IntProperty(name="Number", description="Which one, counted from 0", min=0, default=0, options=ONCE)

    async def work(self, context: Context) -> str:
        obj = writable_mesh(context, context.active_object.name)
        with stage("Choosing"):
            await pause()
        return choose_symmetry(context, obj, self.number)


class ZOOMOUT_OT_swap_sides(SymmetryOperator):
    bl_idname = "zoomout.swap_sides"
    bl_label = "Swap Sides of Symmetry"
    bl_description = "Take left for right, in the symmetry that is chosen: where the axis told them apart wrongly"
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        obj = writable_mesh(context, context.active_object.name)
        with stage("Swapping"):
            await pause()
        return swap_sides(context, obj)
