# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare how the active mesh plays the animation of its rig with how the source does."""

from __future__ import annotations

from bpy.types import Context

from zoomout_core.messages import sentences
from zoomout_core.transfer import rigging

from .. import services
from .base.matched_operator import MatchedOperator


class ZOOMOUT_OT_check_motion(MatchedOperator):
    bl_idname = "zoomout.check_motion"
    bl_label = "Check Motion"
    bl_description = (
        "Play the animation on the source and on the active mesh. Report where feet slide, sink or float, or touching "
        "parts come apart, while the source's do not. Lengths are relative to the legs"
    )
    bl_options = {"REGISTER"}

    async def work(self, context: Context) -> str:
        checked = await services.check_motion.check_motion_async(context, context.active_object.name)
        return sentences(*rigging.motion.note_on_motions([checked]))
