# SPDX-License-Identifier: GPL-3.0-or-later
"""Move a copy of the source's armature into the active and other selected meshes, and bind them to it."""

from __future__ import annotations

from dataclasses import replace

from bpy.types import Context

from zoomout_core.messages import enumeration

from .. import services
from ..jobs import Work
from ..mesh_data import armatures_of
from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from ..properties.transfer import BindOptions, BlendOptions
from ..scene.selection import choose_source, sources_of_targets
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
        "armature keeps it, and gets the bones of another source that move that part, such as those of its face. An "
        "armature without bone weights, such as a metarig, moves alone if it is selected, too"
    )
    bl_options = {"REGISTER", "UNDO"}

    def draw(self, context: Context) -> None:
        """Draw the options that can be adjusted without matching again."""
        draw_binding(self, tuple(BindOptions.__annotations__))

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        if self.mask_group and armatures_of(context.active_object):
            return await self._add_bones(context)
        sources = sources_of_targets(context, self.source)
        if armature := services.binding.loose_armature.loose_armature(context, sources.values()):
            return await self._move_armature(context, armature, sources)
        return services.transfer_report.summarise_targets(
            await bind_targets(self, context, replace(self.how_to_bind(), move_rig=True)), False
        )

    async def _add_bones(self, context: Context) -> str:
        """Add the bones of the source that move a part to the armature of the active mesh."""
        target = context.active_object
        added = await services.binding.part.add_bones_async(
            context,
            choose_source(context, target, self.source).name,
            target.name,
            self.mask_group,
            services.matching.made_match.MatchUse(
                self.options.is_repeat, remedy=self.remedy, undo_step=self.adds_undo_steps
            ),
            **self.match_options(),
        )
        preview.clear()  # it would hide the result
        return added.sentence

    async def _move_armature(self, context: Context, armature: str, source_of: dict[str, str]) -> str:
        """Place a copy of an armature without weights in the active mesh and the other selected ones."""
        options = self.match_options()
        undo_step = self.adds_undo_steps and len(source_of) == 1
        use = services.matching.made_match.MatchUse(self.options.is_repeat, remedy=self.remedy, undo_step=undo_step)

        def work(target: str) -> Work[services.targets.Write[services.binding.loose_armature.MovedArmature]]:
            return services.binding.loose_armature.prepare_armature(
                context, armature, source_of[target], target, use, **options
            )

        outcome = await services.targets.each_target(list(source_of), work)
        preview.clear()  # it would hide the result
        self.report_failed(outcome)
        return enumeration((each.sentence for each in outcome.done.values()), "; ")
