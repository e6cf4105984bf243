# SPDX-License-Identifier: GPL-3.0-or-later
"""Match each mesh of a collection with its partner in another one."""

from __future__ import annotations

from bpy.types import Context

from zoomout_core.messages import enumeration, message

from ... import services
from ...scene.selection import select_only
from ...storage import stored_match
from ..base import activity
from ..base.availability import is_available
from ..base.modal_operator import ModalOperator


class ZOOMOUT_OT_match_collections(ModalOperator):
    bl_idname = "zoomout.match_collections"
    bl_label = "Match Collections"
    bl_description = (
        "Match two characters that consist of several meshes, such as body, eyes and clothes. Each mesh of the "
        "target collection is matched to its partners in the source collection; similar names help"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether both collections are chosen."""
        settings, reason = context.scene.zoomout, ""
        if activity.running:
            reason = activity.AT_WORK
        elif settings.source_collection is None or settings.target_collection is None:
            reason = "Choose both collections in the sidebar"
        return is_available(cls, reason)

    async def work(self, context: Context) -> str:
        settings = context.scene.zoomout
        names = settings.source_collection.name, settings.target_collection.name
        matches = await services.matching.collection_match.match_collections_async(
            context, *names, detail=settings.detail.lower()
        )
        pairs = enumeration(
            message(
                "'{target}' with '{source}'{others}",
                target=target,
                source=source,
                others=services.transfer_report.and_others(match.others),
            )
            for target, (source, match) in matches.items()
        )
        select_only(context, list(matches))  # a transfer then uses the source of each target
        doubtful = sum(stored_match.low_confidence(match.confidence) for _, match in matches.values())
        vertices = sum(len(match.confidence) for _, match in matches.values())
        return message(
            "Matched {pairs}; {doubtful:,} of {vertices:,} vertices are doubtful",
            pairs=pairs,
            doubtful=doubtful,
            vertices=vertices,
        )
