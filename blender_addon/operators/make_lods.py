# SPDX-License-Identifier: GPL-3.0-or-later
"""Make levels of detail of the active and other selected meshes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from bpy.types import Context

import zoomout_core as zo
from zoomout_core.messages import enumeration

from .. import services
from ..properties.lods import LevelOptions
from ..properties.settings import take_settings
from ..scene.selection import chosen_targets
from .base.modal_operator import ModalOperator


class ZOOMOUT_OT_make_lods(LevelOptions, ModalOperator):
    bl_idname = "zoomout.make_lods"
    bl_label = "Make LODs"
    bl_description = (
        "Make levels of detail of the active mesh, and of the other selected ones, for games: objects with fewer "
        "vertices and all data, named NAME_LOD0, NAME_LOD1 and so on. Seams, borders of materials and symmetry are kept"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        names, choice = [obj.name for obj in chosen_targets(context)], services.lods.LevelChoice(**self.level_choice())
        if self.lod_source == "SELECTED":
            names, meshes = names[:1], tuple(names[1:])
            if not meshes:
                raise zo.MeshError("No meshes of levels are selected: select them first, and the detailed mesh last.")
            choice = replace(choice, meshes=meshes)
        outcome = await services.targets.each_target(
            names, partial(services.lods.prepare_levels, context, choice=choice)
        )
        self.report_failed(outcome)
        return enumeration((services.lods.summary(report) for report in outcome.done.values()), "; ")
