# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake the textures of the source for the active and other selected meshes."""

from __future__ import annotations

from functools import partial

from bpy.types import Context

from zoomout_core.messages import enumeration

from .. import services
from ..properties.bake import BakeOptions
from ..properties.settings import take_settings
from ..scene.selection import chosen_targets, match_source
from ..viewport import preview
from .base.matched_operator import MatchedOperator


class ZOOMOUT_OT_bake_textures(BakeOptions, MatchedOperator):
    bl_idname = "zoomout.bake_textures"
    bl_label = "Bake Textures"
    bl_description = (
        "Bake the images of the source's materials into the UV map of the active mesh, and of the other selected "
        "ones, along the match: colors, normal maps, masks and UDIM tiles. No cage is needed, and poses may differ"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        source = context.scene.objects.get(match_source(context, context.active_object))
        names = [obj.name for obj in chosen_targets(context, source) if match_source(context, obj)]
        outcome = await services.targets.each_target(
            names, partial(services.bake.prepare_bake, context, baking=services.bake.Baking(**self.bake_options()))
        )
        preview.clear()  # it would hide the result
        self.report_failed(outcome)
        return enumeration((services.bake.summary(report) for report in outcome.done.values()), "; ")
