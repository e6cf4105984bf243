"""Show a match by colours over the target and its source, and stop showing it.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

from bpy.props import EnumProperty
from bpy.types import Context, Operator, OperatorProperties

from zoomout_core.progress import Steps

from .. import match_preview, overlay
from ..pair import check_unedited
from ..stored_match import read_kept_steps
from .stepped import SteppedOperator

KINDS = (
    (match_preview.CONFIDENCE, "Confidence", "How far to trust the match at each vertex: blue is sure, red is a guess"),
    (match_preview.PLACES, "Places", "Each place of the source has a colour, and the target shows where it found them"),
    (match_preview.CHECKER, "UV Checker", "How the source's active UV map will lie on the target"),
)


class ZOOMOUT_OT_preview(SteppedOperator):
    bl_idname = "zoomout.preview"
    bl_label = "Show Match"
    bl_description = "Show the match of the active mesh by colours in the viewport. Nothing in the file is changed"
    bl_options = {"REGISTER"}

    kind: EnumProperty(name="Preview", description="What the colours show", items=KINDS, default=match_preview.PLACES)

    @classmethod
    def description(cls, context: Context, properties: OperatorProperties) -> str:
        """Of the kind that a button shows."""
        return next(text for kind, _, text in KINDS if kind == properties.kind)

    def steps(self, context: Context) -> Steps[str]:
        target = context.active_object
        pair, match = yield from read_kept_steps(context, target.name)
        coats = yield from match_preview.coats_steps(context, pair, match, self.kind)
        check_unedited(context, pair)
        match_preview.show(self.kind, coats)
        return f"Showing the match of '{pair.target_name}'"


class ZOOMOUT_OT_clear_preview(Operator):
    bl_idname = "zoomout.clear_preview"
    bl_label = "Hide Match"
    bl_description = "Stop showing the match; the viewport is as it was before"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether there is one."""
        if not overlay.shown():
            cls.poll_message_set("There is no preview")
        return bool(overlay.shown())

    def execute(self, context: Context) -> set[str]:
        """Take the colours away."""
        overlay.clear()
        return {"FINISHED"}
