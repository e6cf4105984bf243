# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror shape keys of the active mesh, split them, or make them symmetric."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ...properties.settings import take_settings
from ...properties.symmetry import DirectionOptions, KeyName, KeyOptions
from .base import SymmetryOperator


class ZOOMOUT_OT_mirror_shape_key(KeyName, KeyOptions, DirectionOptions, SymmetryOperator):
    bl_idname = "zoomout.mirror_shape_key"
    bl_label = "Mirror Shape Key by Symmetry"
    bl_description = (
        "Create the opposite key from the active shape key, split it into left and right keys, or make it symmetric. "
        "Displacements rotate with the surface, so the mesh can be in any pose"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        obj = context.active_object
        key = self.key or (obj.active_shape_key.name if obj.active_shape_key else "")
        mode, direction = self.key_mode.lower(), self.direction.lower()
        return await services.symmetry.shape_keys.mirror_shape_key_async(
            context, obj.name, key, mode, direction, self.blend
        )
