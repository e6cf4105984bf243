# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose all the data that a transfer can take, or none of it.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
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
        """Set the check marks."""
        for name in USUAL_DATA:
            setattr(context.scene.zoomout, name, self.every)
        return {"FINISHED"}
