# SPDX-License-Identifier: GPL-3.0-or-later
"""Find a source for the active mesh in libraries, and append it.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import StringProperty
from bpy.types import Context, Operator

import zoomout_core as zo
from zoomout_core.messages import Message, message, probability

from .. import services
from ..properties.once import ONCE
from ..scene.selection import library_folders
from ..translations import reported, translated
from .base import activity
from .base.availability import is_available
from .base.modal_operator import ModalOperator


class ZOOMOUT_OT_find_source(ModalOperator):
    bl_idname = "zoomout.find_source"
    bl_label = "Find Source"
    bl_description = (
        "Find the character of a library that fits the active mesh best, whatever its pose. New files of the library "
        "are prepared first; nothing is appended until you choose a file"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether there is a mesh to search for, and a library."""
        obj, reason = context.active_object, ""
        if activity.running:
            reason = activity.AT_WORK
        elif obj is None or obj.type != "MESH":
            reason = "Select the mesh that needs a source"
        elif not library_folders(context):
            reason = "Choose a library in the sidebar"
        return is_available(cls, reason)

    async def work(self, context: Context) -> str:
        target = context.active_object.name
        search = await services.library.find_source_async(context, target, library_folders(context))
        settings, found = context.scene.zoomout, search.found
        settings.found_for = target
        settings.found_sources.clear()
        for each in found.ranked:
            row = settings.found_sources.add()
            row.name, row.fits = str(each.path), each.fits
            row.line = translated(
                message(
                    "{name}: fit {fit:.0%}, {certainty} certain",
                    name=each.name,
                    fit=1 - each.misfit,
                    certainty=probability(each.certainty),
                )
            )
        part = found.part
        settings.found_part = "" if part is None else str(part.path)
        settings.found_part_joints = "" if part is None else "\n".join(part.joints)
        settings.found_part_line = "" if part is None else translated(_line_of_part(part))
        for sentence in search.failures.values():
            self.report({"WARNING"}, reported(sentence))
        return found.refusal or found.note or message("'{name}' fits best", name=found.ranked[0].path.name)


def _line_of_part(part: "zo.FoundPart") -> Message:
    """A part, and how well its source fits it."""
    return message(
        "{joint}: {name}, fit {fit:.1%} instead of {fit_of_best:.1%}",
        joint=part.joint,
        name=part.path.stem,
        fit=part.fit,
        fit_of_best=part.fit_of_best,
    )


class ZOOMOUT_OT_append_source(Operator):
    bl_idname = "zoomout.append_source"
    bl_label = "Append Source"
    bl_description = (
        "Append the objects of this file, and use its largest mesh as the source. If the file fits only a part "
        "better, Mask is set to the vertex groups of that part, so that the next transfer keeps the rest"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether nothing else is at work."""
        return is_available(cls, activity.AT_WORK if activity.running else "")

    path: StringProperty(name="File", description="File to append", subtype="FILE_PATH", options=ONCE)
    joints: StringProperty(
        name="Joints",
        description="Vertex groups of the active mesh to which transfers are limited, one a line; empty for no limit",
        options=ONCE,
    )

    def execute(self, context: Context) -> set[str]:
        """Append the file."""
        target = context.view_layer.objects.active
        try:
            source = services.library.append_source(context, self.path, self.joints.split("\n") if self.joints else ())
        except zo.MeshError as error:
            self.report({"ERROR"}, reported(str(error)))
            return {"CANCELLED"}
        context.view_layer.objects.active = target
        done = message("'{name}' is the source now", name=source.name)
        if self.joints:
            mask = context.scene.zoomout.mask_group
            done = message("{done}, and Mask is '{mask}': match again and transfer", done=done, mask=mask)
        self.report({"INFO"}, reported(done))
        return {"FINISHED"}


CLASSES = (ZOOMOUT_OT_find_source, ZOOMOUT_OT_append_source)
