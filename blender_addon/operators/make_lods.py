# SPDX-License-Identifier: GPL-3.0-or-later
"""Make levels of detail of the active and other selected meshes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from bpy.types import Context

from zoomout_core.mesh.surface import MeshError
from zoomout_core.messages import enumeration

from ..properties.lods import LevelOptions
from ..properties.settings import take_settings
from ..scene.selection import chosen_targets
from ..services.lods import LevelChoice, prepare_levels, summary
from ..services.targets import each_target
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
        names, choice = [obj.name for obj in chosen_targets(context)], LevelChoice(**self.level_choice())
        if self.lod_source == "SELECTED":
            names, meshes = names[:1], tuple(names[1:])
            if not meshes:
                raise MeshError("No meshes of levels are selected: select them first, and the detailed mesh last.")
            choice = replace(choice, meshes=meshes)
        outcome = await each_target(names, partial(prepare_levels, context, choice=choice))
        self.report_failed(outcome)
        return enumeration((summary(report) for report in outcome.done.values()), "; ")
