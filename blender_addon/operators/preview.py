# SPDX-License-Identifier: GPL-3.0-or-later
"""Show or hide a preview of a match or a symmetry, by colours over objects.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import EnumProperty
from bpy.types import Context, Operator, OperatorProperties

from zoomout_core.messages import message

from .. import services
from ..scene.pair import check_not_edited
from ..scene.stored_pair import read_stored_match
from ..translations import translated
from ..viewport import preview
from ..viewport.preview import ASYMMETRY, OF_BINDING, OF_MATCH, OF_SYMMETRY
from .base.availability import is_available
from .base.modal_operator import ModalOperator

# Asymmetry has options, and therefore a separate operator.
KINDS = {name: kind for name, kind in (OF_MATCH | OF_BINDING | OF_SYMMETRY).items() if name != ASYMMETRY}


class ZOOMOUT_OT_preview(ModalOperator):
    bl_idname = "zoomout.preview"
    bl_label = "Show Match or Symmetry"
    bl_description = (
        "Show the match or the symmetry of the active mesh as colors in the viewport. This does not change the file"
    )
    bl_options = {"REGISTER"}

    kind: EnumProperty(
        name="Preview",
        description="What the colors show",
        items=tuple((name, kind.label, kind.description) for name, kind in KINDS.items()),
        default=preview.PLACES,
    )

    @classmethod
    def description(cls, context: Context, properties: OperatorProperties) -> str:
        """The tooltip of the preview that a button shows."""
        return translated(KINDS[properties.kind].description)

    async def work(self, context: Context) -> str:
        name = context.active_object.name
        if self.kind in OF_SYMMETRY:
            preview.show(await services.matching.previews.of_symmetry(context, name, self.kind))
            return message("Showing the symmetry of '{name}'", name=name)
        if self.kind in OF_BINDING:
            preview.show(services.matching.previews.of_binding(context.active_object))
            return message("Showing the binding of '{name}'", name=name)
        pair, match = await read_stored_match(context, name)
        made = await services.matching.previews.of_match(context, pair, match, self.kind)
        check_not_edited(context, pair)
        preview.show(made)
        return message("Showing the match of '{name}'", name=name)


class ZOOMOUT_OT_clear_preview(Operator):
    bl_idname = "zoomout.clear_preview"
    bl_label = "Hide Colors"
    bl_description = "Remove the colors and restore the viewport"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether there is a preview."""
        return is_available(cls, "There is no preview" if preview.current() is None else "")

    def execute(self, context: Context) -> set[str]:
        """Remove the preview."""
        preview.clear()
        return {"FINISHED"}
