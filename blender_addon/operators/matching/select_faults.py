# SPDX-License-Identifier: GPL-3.0-or-later
"""Select elements of the active mesh where the match is doubtful, flipped, or without a partner."""

from __future__ import annotations

from bpy.types import Context

from ... import services
from ...scene.faults import DOUBTFUL, FLIPPED, TORN, WITHOUT_PARTNER, stretched_vertices
from ..base.availability import is_available
from ..base.matched_operator import MatchedOperator
from ..base.modal_operator import ModalOperator


class SelectOperator(MatchedOperator):
    """The base of operators that select faults of the match of the active mesh."""

    bl_options = {"REGISTER", "UNDO"}
    what = ""
    # The value of `ToolSettings.mesh_select_mode`: vertices, edges, faces.
    selecting = (True, False, False)

    async def work(self, context: Context) -> str:
        result = await services.matching.select_faults.select_faults_async(
            context, context.active_object.name, self.what
        )
        context.tool_settings.mesh_select_mode = self.selecting  # Edit Mode deselects elements of other modes
        return result


class ZOOMOUT_OT_select_doubtful(SelectOperator):
    bl_idname = "zoomout.select_doubtful"
    bl_label = "Select Doubtful"
    bl_description = (
        "Select the doubtful vertices of the active mesh, whose confidence is below 0.5, to check them in Edit Mode"
    )
    what = DOUBTFUL


class ZOOMOUT_OT_select_flipped(SelectOperator):
    bl_idname = "zoomout.select_flipped"
    bl_label = "Select Flipped"
    bl_description = "Select the faces of the active mesh that the match flips, to check them in Edit Mode"
    what = FLIPPED
    selecting = (False, False, True)


class ZOOMOUT_OT_select_torn(SelectOperator):
    bl_idname = "zoomout.select_torn"
    bl_label = "Select Torn"
    bl_description = "Select the vertices of the active mesh where the match tears it apart, to check them in Edit Mode"
    what = TORN


class ZOOMOUT_OT_select_without_partner(SelectOperator):
    bl_idname = "zoomout.select_without_partner"
    bl_label = "Select Without Partner"
    bl_description = (
        "Select the vertices of the active mesh and of the source that have no partner on the other mesh, to "
        "check them in Edit Mode"
    )
    what = WITHOUT_PARTNER


class ZOOMOUT_OT_select_stretched(ModalOperator):
    bl_idname = "zoomout.select_stretched"
    bl_label = "Select Stretched"
    bl_description = (
        "Select the vertices of the active mesh that stretch far more than the source when the bones of its rig "
        "rotate, to check their weights in Edit Mode or Weight Paint"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active object was bound."""
        if not super().poll(context):
            return False
        is_bound = stretched_vertices(context.active_object) is not None
        return is_available(cls, "" if is_bound else "Bind this mesh to a rig first")

    async def work(self, context: Context) -> str:
        result = services.matching.select_faults.select_stretched(context, context.active_object)
        context.tool_settings.mesh_select_mode = (True, False, False)
        return result


CLASSES = (
    ZOOMOUT_OT_select_doubtful,
    ZOOMOUT_OT_select_flipped,
    ZOOMOUT_OT_select_stretched,
    ZOOMOUT_OT_select_torn,
    ZOOMOUT_OT_select_without_partner,
)
