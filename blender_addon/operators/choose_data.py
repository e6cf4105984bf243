# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn on all kinds of data for a transfer, or turn them off.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty
from bpy.types import Context, Operator

from ..adapters import USUAL_DATA


class ZOOMOUT_OT_choose_data(Operator):
    bl_idname = "zoomout.choose_data"
    bl_label = "Choose Data"
    bl_description = "Turn on all kinds of data to transfer, or turn them off"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    every: BoolProperty(name="All", description="Turn everything on instead of off", default=True)

    def execute(self, context: Context) -> set[str]:
        """Set or clear all kinds."""
        for name in USUAL_DATA:
            setattr(context.scene.zoomout, name, self.every)
        return {"FINISHED"}
