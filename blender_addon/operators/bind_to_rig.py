# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind the active and other selected meshes to the armature of a source."""

from __future__ import annotations

from typing import Any

from bpy.types import Context

from ..jobs import Work
from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from ..properties.transfer import BLENDING, NAMING, BindOptions, BindView, BlendOptions
from ..scene.selection import sources_of_targets
from ..services.binding import hide_sources
from ..services.targets import Write, each_target
from ..services.transfer import done, prepare_transfer
from ..viewport import preview
from .modal_operator import ModalOperator


class ZOOMOUT_OT_bind_to_rig(SourceName, MatchOptions, BlendOptions, BindOptions, BindView, ModalOperator):
    bl_idname = "zoomout.bind_to_rig"
    bl_label = "Bind to Rig"
    bl_description = (
        "Transfer vertex groups to the active mesh and the other selected ones, move them to Rest Position, and bind "
        "them to the source's armature. Meshes without a match are matched first"
    )
    bl_options = {"REGISTER", "UNDO"}

    def draw(self, context: Context) -> None:
        """Draw the options that can be adjusted without matching again."""
        self.layout.use_property_split = True
        for names in ((*BindOptions.__annotations__, *BindView.__annotations__), BLENDING, NAMING):
            column = self.layout.box().column()
            for name in names:
                column.prop(self, name)

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        source_of = sources_of_targets(context, self.source)
        settings, options, binding = self.settings(), self.match_options(), self.how_to_bind()

        def work(target: str) -> Work[Write[dict[str, Any]]]:
            return prepare_transfer(
                context,
                source_of[target],
                target,
                (),
                settings,
                binding,
                self.options.is_repeat,
                undo_step=self.adds_undo_steps and len(source_of) == 1,
                **options,
            )

        outcome = await each_target(list(source_of), work)
        preview.clear()  # it would hide the result
        if self.hide_source:
            hide_sources(context, outcome.done.values())
        self.report_failed(outcome)
        return done(outcome.done.values(), self.hide_source)
