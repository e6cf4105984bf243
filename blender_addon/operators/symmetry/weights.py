# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the weights of the active mesh the same on both sides."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ...properties.settings import take_settings
from ...properties.symmetry import DirectionOptions, WeightOptions
from .base import SymmetryOperator


class ZOOMOUT_OT_symmetrise_weights(DirectionOptions, WeightOptions, SymmetryOperator):
    bl_idname = "zoomout.symmetrise_weights"
    bl_label = "Symmetrize Weights"
    bl_description = (
        "Copy weights from one side to the other, or exchange them, with Arm.L becoming Arm.R. Missing partner "
        "groups are created, and locked groups are not changed"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        obj = context.active_object
        active = obj.vertex_groups.active
        only = active.name if self.only_active and active else ""
        return await services.symmetry.weights.symmetrise_weights_async(context, obj.name, self.direction.lower(), only)
