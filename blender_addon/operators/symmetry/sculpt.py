"""Carry what was sculpted on one side of the active mesh to the other one."""

from __future__ import annotations

from bpy.types import Context

from zoomout_core.runtime.stepping import Steps

from ...properties.settings import take_settings
from ...properties.symmetry import DirectionOptions
from ...services.symmetry.sculpt import mirror_sculpt_steps
from .base import SymmetryOperator


class ZOOMOUT_OT_mirror_sculpt(DirectionOptions, SymmetryOperator):
    bl_idname = "zoomout.mirror_sculpt"
    bl_label = "Mirror Sculpt"
    bl_description = (
        "Carry to the other side how vertices of the active mesh were moved since its symmetry was detected. "
        "Displacements turn with the surface, so it may be in any pose"
    )
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        take_settings(self, context.scene.zoomout.symmetry)
        return (yield from mirror_sculpt_steps(context, context.active_object.name, self.direction.lower()))
