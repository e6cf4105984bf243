# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror sculpting from one side of the active mesh to the other."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ...properties.settings import take_settings
from ...properties.symmetry import DirectionOptions
from .base import SymmetryOperator


class ZOOMOUT_OT_mirror_sculpt(DirectionOptions, SymmetryOperator):
    bl_idname = "zoomout.mirror_sculpt"
    bl_label = "Mirror Sculpt"
    bl_description = (
        "Mirror all changes to the shape of the active mesh since its symmetry was detected. Displacements rotate "
        "with the surface, so the mesh can be in any pose"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        return await services.symmetry.sculpt.mirror_sculpt_async(
            context, context.active_object.name, self.direction.lower()
        )
