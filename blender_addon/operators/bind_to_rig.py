# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind the active and other selected meshes to the armature of a source."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bpy.types import Context

from .. import services
from ..adapters import Binding
from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from ..properties.transfer import BLENDING, NAMING, BindOptions, BindView, BlendOptions
from ..scene.selection import sources_of_targets
from .base.modal_operator import ModalOperator
from .base.transfer_to_targets import transfer_to_targets


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
        draw_binding(self, (*BindOptions.__annotations__, *BindView.__annotations__))

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        reports = await bind_targets(self, context, self.how_to_bind())
        if self.hide_source:
            services.binding.write.hide_sources(context, reports)
        return services.transfer_report.summarise_targets(reports, self.hide_source)


def draw_binding(operator: ModalOperator, names: Sequence[str]) -> None:
    """Draw options of binding, by name, and those of transferring weights."""
    operator.layout.use_property_split = True
    for group in (names, BLENDING, NAMING):
        column = operator.layout.box().column()
        for name in group:
            column.prop(operator, name)


async def bind_targets(operator: Any, context: Context, binding: Binding) -> list[dict[str, Any]]:
    """Bind the active and other selected meshes, by the options of an operator; returns their reports."""
    return await transfer_to_targets(operator, context, sources_of_targets(context, operator.source), (), binding)
