# SPDX-License-Identifier: GPL-3.0-or-later
"""Move a copy of the source's armature into the active and other selected meshes, and bind them to it."""

from __future__ import annotations

from dataclasses import replace

from bpy.types import Context

from ..mesh_data import armatures_of
from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from ..properties.transfer import BindOptions, BlendOptions
from ..scene.selection import choose_source
from ..services.binding.part import add_bones_async
from ..services.matching.made_match import MatchUse
from ..services.transfer import done
from ..viewport import preview
from .base.modal_operator import ModalOperator
from .bind_to_rig import bind_targets, draw_binding


class ZOOMOUT_OT_move_rig(SourceName, MatchOptions, BlendOptions, BindOptions, ModalOperator):
    bl_idname = "zoomout.move_rig"
    bl_label = "Move Rig"
    bl_description = (
        "Copy the source's armature, move its bones into the body of the active mesh, and bind the mesh to the copy "
        "with the source's vertex groups. Does the same for the other selected meshes. For meshes of another build: "
        "they keep their place and size, and are matched first if necessary. With Mask, an active mesh that has an "
        "armature keeps it, and gets the bones of another source that move that part, such as those of its face"
    )
    bl_options = {"REGISTER", "UNDO"}

    def draw(self, context: Context) -> None:
        """Draw the options that can be adjusted without matching again."""
        draw_binding(self, tuple(BindOptions.__annotations__))

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        if self.mask_group and armatures_of(context.active_object):
            return await self._add_bones(context)
        return done(await bind_targets(self, context, replace(self.how_to_bind(), move_rig=True)), False)

    async def _add_bones(self, context: Context) -> str:
        """Add the bones of the source that move a part to the armature of the active mesh."""
        target = context.active_object
        added = await add_bones_async(
            context,
            choose_source(context, target, self.source).name,
            target.name,
            self.mask_group,
            MatchUse(self.options.is_repeat, remedy=self.remedy, undo_step=self.adds_undo_steps),
            **self.match_options(),
        )
        preview.clear()  # it would hide the result
        return added.sentence
