# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress the active mesh with the clothes of a source."""

from __future__ import annotations

from bpy.props import StringProperty
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.runtime.progress import stage

from .. import services
from ..jobs import pause
from ..properties.dress import DressOptions
from ..properties.match import MatchOptions
from ..properties.once import ONCE
from ..properties.settings import SourceName, take_settings
from ..scene.selection import select_only, source_of_worn, worn_names
from ..viewport import preview
from .base.modal_operator import ModalOperator


class ZOOMOUT_OT_dress(SourceName, MatchOptions, DressOptions, ModalOperator):
    bl_idname = "zoomout.dress"
    bl_label = "Dress"
    bl_description = (
        "Fit copies of the source's clothes, hair, eyes and other objects to the active mesh, and bind them to the "
        "same rig. Uses the collection chosen in the sidebar, otherwise the objects selected besides the source and "
        "the target"
    )
    bl_options = {"REGISTER", "UNDO"}

    collection: StringProperty(
        name="Collection",
        description="Name of the collection to fit; if empty, the one chosen in the sidebar",
        options=ONCE,
    )

    def draw(self, context: Context) -> None:
        """Draw the options that can be adjusted without matching again."""
        self.layout.use_property_split = True
        for name in DressOptions.__annotations__:
            self.layout.prop(self, name)

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        target = context.active_object
        source = source_of_worn(context, target, self.source)
        if source == target.name:
            raise zo.MeshError("The active mesh is the source: make the mesh to dress active.")
        names = worn_names(context, source, target.name, self.collection)
        dressing = services.dressing.read.Dressing(**self.dress_options())
        use, options = (
            services.matching.made_match.MatchUse(self.options.is_repeat, remedy=self.remedy),
            self.match_options(),
        )
        write = await services.dressing.dress.prepare_dress(
            context, source, target.name, names, dressing, use, **options
        )
        with stage(services.targets.WRITING, 1):
            await pause()
        report = write()
        preview.clear()  # it would hide the result
        select_only(context, [report["target"], *report["objects"].values()])
        return services.dressing.dress.summary(report)
