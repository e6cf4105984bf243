# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer data from a source to the active and other selected meshes, along their matches."""

from __future__ import annotations

from bpy.types import Context

import zoomout_core as zo

from .. import services
from ..properties.match import MatchOptions
from ..properties.settings import OwnSources, SourceName, take_settings
from ..properties.transfer import BLENDING, NAMING, BindChoice, BindOptions, BindView, BlendOptions, TransferOptions
from ..scene.selection import chosen_targets, sources_of_targets
from ..storage import stored_match
from .base.modal_operator import ModalOperator
from .base.transfer_to_targets import transfer_to_targets


class ZOOMOUT_OT_transfer(
    SourceName,
    OwnSources,
    MatchOptions,
    TransferOptions,
    BlendOptions,
    BindChoice,
    BindOptions,
    BindView,
    ModalOperator,
):
    bl_idname = "zoomout.transfer"
    bl_label = "Transfer"
    bl_description = (
        "Transfer data from the source to the active mesh, and to the other selected ones, through their matches. "
        "Meshes without a match are matched first. The source is the one chosen above, or the one of the last match"
    )
    bl_options = {"REGISTER", "UNDO"}

    def draw(self, context: Context) -> None:
        """Draw the options that can be adjusted without matching again."""
        self.layout.use_property_split = True
        column = self.layout.column(heading="Data")
        for name in TransferOptions.__annotations__:
            column.prop(self, name)
        binding = (*BindChoice.__annotations__, *BindOptions.__annotations__, *BindView.__annotations__)
        for names in (BLENDING, NAMING, binding):
            column = self.layout.box().column()
            for name in names:
                column.prop(self, name)

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        source_of = _own_sources(context) if self.own_sources else sources_of_targets(context, self.source)
        binding = self.how_to_bind() if self.bind else None
        reports = await transfer_to_targets(self, context, source_of, self.data(), binding)
        if self.hide_source:
            services.binding.write.hide_sources(context, reports)
        return services.transfer_report.summarise_targets(reports, self.hide_source)


def _own_sources(context: Context) -> dict[str, str]:
    """The names of the sources that all targets were matched with, by the targets' names.

    Raises:
        MeshError: a target was not matched.
    """
    stored = {obj.name: stored_match.description(obj.data) for obj in chosen_targets(context)}
    for name, description in stored.items():
        if description is None:
            raise zo.MeshError("'{target}' was not matched yet: match it first.", target=name)
    return {name: description["source"] for name, description in stored.items() if description}
