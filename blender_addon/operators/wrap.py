# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrap the active and other selected meshes onto a source, or the source onto the active mesh."""

from __future__ import annotations

from typing import Any

from bpy.types import Context

from .. import services
from ..jobs import Work
from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from ..properties.wrap import WrapOptions
from ..scene.selection import sources_of_targets
from ..viewport import preview
from .base.modal_operator import ModalOperator


class ZOOMOUT_OT_wrap(SourceName, MatchOptions, WrapOptions, ModalOperator):
    bl_idname = "zoomout.wrap"
    bl_label = "Wrap"
    bl_description = (
        "Deform the active mesh, and the other selected ones, to the shape of the source, keeping their topology. "
        "Meshes without a match are matched first"
    )
    bl_options = {"REGISTER", "UNDO"}

    def draw(self, context: Context) -> None:
        """Draw the options that can be adjusted without matching again."""
        self.layout.use_property_split = True
        for name in WrapOptions.__annotations__:
            self.layout.prop(self, name)

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        source_of = sources_of_targets(context, self.source)
        wrapping, options = services.wrap.Wrapping(**self.wrap_options()), self.match_options()
        services.wrap.check_one_target(wrapping, source_of)
        use = services.matching.made_match.MatchUse(self.options.is_repeat, remedy=self.remedy)

        def work(target: str) -> Work[services.targets.Write[dict[str, Any]]]:
            return services.wrap.prepare_wrap(context, source_of[target], target, wrapping, use, **options)

        outcome = await services.targets.each_target(list(source_of), work)
        preview.clear()  # it would hide the result
        self.report_failed(outcome)
        return " ".join(services.wrap.summary(report) for report in outcome.done.values())
