# SPDX-License-Identifier: GPL-3.0-or-later
"""Bend the match of the active mesh to its landmarks."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ..base.matched_operator import MatchedOperator


class ZOOMOUT_OT_bend_match(MatchedOperator):
    bl_idname = "zoomout.bend_match"
    bl_label = "Bend Match to Landmarks"
    bl_description = (
        "Correct the match of the active mesh near landmarks that it misses, without matching again; the rest of the "
        "match is kept. If a landmark is far off, match again instead"
    )
    bl_options = {"REGISTER", "UNDO"}

    async def work(self, context: Context) -> str:
        return await services.matching.bend_match.bend_match_async(context, context.active_object.name)
