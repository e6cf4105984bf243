# SPDX-License-Identifier: GPL-3.0-or-later
"""Remove stored matches and related data from some meshes or the whole file.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty
from bpy.types import Context, Event, OperatorProperties

from zoomout_core.runtime.progress import stage

from .. import services
from ..jobs import pause
from ..translations import translated
from .base import activity
from .base.availability import is_available
from .base.modal_operator import ModalOperator

OF_FILE = (
    "Remove all matches, candidates, reports, symmetries and landmarks from all meshes and scenes of this file. "
    "Transferred data is kept"
)


class ZOOMOUT_OT_clear_match_data(ModalOperator):
    bl_idname = "zoomout.clear_match_data"
    bl_label = "Clear Match Data"
    bl_description = (
        "Remove matches, candidates, reports, symmetries and landmarks from the active mesh and the other selected "
        "ones. Transferred data is kept"
    )
    bl_options = {"REGISTER", "UNDO"}

    whole_file: BoolProperty(
        name="Whole File",
        description=OF_FILE,
        default=False,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, context: Context, properties: OperatorProperties) -> str:
        """The tooltip of a button, for the meshes or the whole file."""
        return translated(OF_FILE if properties.whole_file else cls.bl_description)

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether no other operator is running."""
        return is_available(cls, activity.AT_WORK if activity.running else "")

    def invoke(self, context: Context, event: Event) -> set[str]:
        """Ask before clearing a whole file."""
        if self.whole_file:
            return context.window_manager.invoke_confirm(self, event)
        return super().invoke(context, event)

    async def work(self, context: Context) -> str:
        with stage("Clearing"):
            await pause()
        if self.whole_file:
            return services.clear_data.clear_file(context)
        active = context.active_object
        chosen = dict.fromkeys([*([active] if active else []), *context.selected_objects])
        return services.clear_data.clear_match_data(context, chosen)
