# SPDX-License-Identifier: GPL-3.0-or-later
"""Show how asymmetric the active mesh is: its shape, its weights, or a shape key."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ...properties.settings import take_settings
from ...properties.symmetry import CheckOptions, KeyName
from .base import SymmetryOperator


class ZOOMOUT_OT_check_symmetry(KeyName, CheckOptions, SymmetryOperator):
    bl_idname = "zoomout.check_symmetry"
    bl_label = "Show Asymmetry"
    bl_description = (
        "Show as colors how asymmetric the active mesh is, in its shape in any pose, its weights, or a shape key"
    )
    bl_options = {"REGISTER"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        obj = context.active_object
        key = self.key or (obj.active_shape_key.name if obj.active_shape_key else "")
        return await services.symmetry.check.check_symmetry_async(
            context, obj.name, self.check.lower(), key, self.red_length, self.red_weight
        )
