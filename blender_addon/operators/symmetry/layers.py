# SPDX-License-Identifier: GPL-3.0-or-later
"""Make attributes, UV maps, colours, materials, marks, masks and the selection of a mesh the same on both sides."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ...properties.settings import take_settings
from ...properties.symmetry import DirectionOptions, LayerOptions
from .base import SymmetryOperator


class ZOOMOUT_OT_mirror_attributes(LayerOptions, DirectionOptions, SymmetryOperator):
    bl_idname = "zoomout.mirror_attributes"
    bl_label = "Mirror Attributes"
    bl_description = (
        "Copy UVs, colors, attributes, materials, seams and other marks, masks or the selection from one side to the "
        "other, or exchange them"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout.symmetry)
        name, direction, layout = context.active_object.name, self.direction.lower(), self.uv_layout.lower()
        return await services.symmetry.layers.mirror_attributes_async(context, name, self.data(), direction, layout)
