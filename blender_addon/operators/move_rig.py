# SPDX-License-Identifier: GPL-3.0-or-later
"""Move a copy of the source's armature into the active and other selected meshes, and bind them to it."""

from __future__ import annotations

from dataclasses import replace

from bpy.types import Context

from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from ..properties.transfer import BindOptions, BlendOptions
from ..services.transfer import done
from .base.modal_operator import ModalOperator
from .bind_to_rig import bind_targets, draw_binding


class ZOOMOUT_OT_move_rig(SourceName, MatchOptions, BlendOptions, BindOptions, ModalOperator):
    bl_idname = "zoomout.move_rig"
    bl_label = "Move Rig"
    bl_description = (
        "Copy the source's armature, move its bones into the body of the active mesh, and bind the mesh to the copy "
        "with the source's vertex groups. Does the same for the other selected meshes. For meshes of another build: "
        "they keep their place and size, and are matched first if necessary"
    )
    bl_options = {"REGISTER", "UNDO"}

    def draw(self, context: Context) -> None:
        """Draw the options that can be adjusted without matching again."""
        draw_binding(self, tuple(BindOptions.__annotations__))

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        return done(await bind_targets(self, context, replace(self.how_to_bind(), move_rig=True)), False)
