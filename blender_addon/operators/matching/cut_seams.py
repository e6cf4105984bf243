# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut the active mesh along the seams of its source, so that UV islands end exactly where the source's do."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ...properties.settings import SourceName
from ...scene.selection import choose_source
from ..base.modal_operator import ModalOperator


class ZOOMOUT_OT_cut_seams(SourceName, ModalOperator):
    bl_idname = "zoomout.cut_seams"
    bl_label = "Cut Along Seams"
    bl_description = (
        "Cut the active mesh along the seams of the source's active UV map, so that UV islands end exactly there. "
        "This changes the topology but keeps the match, so transfer afterwards"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        target = context.active_object
        source = choose_source(context, target, self.source)
        return await services.matching.seam_cut.cut_seams_async(context, source.name, target.name)
