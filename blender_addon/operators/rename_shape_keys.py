# SPDX-License-Identifier: GPL-3.0-or-later
"""Rename the active mesh's shape keys to another convention of expression keys.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty, EnumProperty
from bpy.types import Context, Event

from zoomout_core.transfer.keys.key_table import CONVENTIONS

from .. import services
from .base.modal_operator import ModalOperator

ABOUT = {
    "arkit": "The 52 expressions of Apple's face tracking, such as mouthSmileLeft",
    "unified": "The expressions of VRChat's face tracking, such as MouthSmileLeft",
    "metahuman": "The controls of MetaHuman's faces, such as CTRL_expressions_mouthCornerPullL",
    "makehuman": "MakeHuman's expression units, such as mouth-corner-puller",
    "oculus": "The 15 visemes of Oculus Lipsync, such as viseme_aa",
    "vrchat": "The 15 visemes of VRChat, such as vrc.v_aa",
    "vrm0": "The presets of VRM 0, such as blink_l and a",
    "vrm1": "The presets of VRM 1, such as blinkLeft and aa",
}


class ZOOMOUT_OT_rename_shape_keys(ModalOperator):
    bl_idname = "zoomout.rename_shape_keys"
    bl_label = "Rename Shape Keys"
    bl_description = (
        "Rename the shape keys of the active mesh to the names of another convention, and list those that are missing. "
        "Drivers and animations follow; keys without a partner keep their names"
    )
    bl_options = {"REGISTER", "UNDO"}

    convention: EnumProperty(
        name="Convention",
        description="Convention of the new names",
        items=tuple((name.upper(), spelling.title, ABOUT[name]) for name, spelling in CONVENTIONS.items()),
        default="ARKIT",
    )
    compose: BoolProperty(
        name="Add Sums",
        description="Add keys that are the sum of several, such as a blink of both eyes; the separate keys are kept",
        default=True,
    )

    def invoke(self, context: Context, event: Event) -> set[str]:
        """Ask for the convention."""
        return context.window_manager.invoke_props_dialog(self)

    async def work(self, context: Context) -> str:
        return services.key_names.rename_shape_keys(
            context, context.active_object, self.convention.lower(), self.compose
        )
