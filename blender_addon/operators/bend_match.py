"""Bend the match of the active mesh to its landmarks."""

from __future__ import annotations

from bpy.types import Context

from ..services.bend_match import bend_match_async
from .matched import MatchedOperator


class ZOOMOUT_OT_bend_match(MatchedOperator):
    bl_idname = "zoomout.bend_match"
    bl_label = "Bend Match to Landmarks"
    bl_description = (
        "Bend the match of the active mesh near the landmarks that it misses, so that it meets them, without matching "
        "again; all that is farther away stays. Where a landmark is far off, match again"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        return await bend_match_async(context, context.active_object.name)
