# SPDX-License-Identifier: GPL-3.0-or-later
"""Link the active and other selected meshes to their sources, and update data that a modifier cannot write."""

from __future__ import annotations

from functools import partial

from bpy.types import Context

from zoomout_core.messages import enumeration

from .. import services
from ..jobs import Work
from ..properties.settings import take_settings
from ..properties.transfer import BlendOptions, TransferOptions
from ..scene.selection import chosen_targets, match_source
from ..storage import stored_link
from ..viewport import preview
from .base.availability import is_available
from .base.matched_operator import MatchedOperator


class LinkOperator(MatchedOperator):
    """The base of operators on the links of the active and other selected meshes."""

    def prepare(self, context: Context, target: str) -> Work[services.targets.Write[dict[str, float]]]:
        """Prepare the link of a target."""
        raise NotImplementedError

    def targets(self, context: Context) -> list[str]:
        """The names of the targets."""
        source = context.scene.objects.get(match_source(context, context.active_object))
        return [obj.name for obj in chosen_targets(context, source) if match_source(context, obj)]

    async def work(self, context: Context) -> str:
        outcome = await services.targets.each_target(self.targets(context), partial(self.prepare, context))
        preview.clear()  # it would hide the result
        self.report_failed(outcome)
        return enumeration((services.live_link.summary(name, shares) for name, shares in outcome.done.items()), "; ")


class ZOOMOUT_OT_keep_linked(TransferOptions, BlendOptions, LinkOperator):
    bl_idname = "zoomout.keep_linked"
    bl_label = "Keep Linked"
    bl_description = (
        "Transfer the chosen data and add a modifier, so that UVs, colors, attributes and vertex groups of the active "
        "mesh and of the other selected ones follow later edits of the source"
    )
    bl_options = {"REGISTER", "UNDO"}

    def prepare(self, context: Context, target: str) -> Work[services.targets.Write[dict[str, float]]]:
        take_settings(self, context.scene.zoomout)
        return services.live_link.prepare_link(context, target, self.data(), self.settings())


class ZOOMOUT_OT_update_linked(LinkOperator):
    bl_idname = "zoomout.update_linked"
    bl_label = "Update Linked"
    bl_description = (
        "Transfer the data chosen for Keep Linked again, including new layers of the source, and shape keys, "
        "materials, seams and custom normals, which the modifier cannot write"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active object is linked."""
        if not super().poll(context):
            return False
        is_linked = stored_link.link_of(context.active_object) is not None
        return is_available(cls, "" if is_linked else "Link this mesh first, with Keep Linked")

    def targets(self, context: Context) -> list[str]:
        objects = context.scene.objects
        return [name for name in super().targets(context) if stored_link.link_of(objects[name]) is not None]

    def prepare(self, context: Context, target: str) -> Work[services.targets.Write[dict[str, float]]]:
        return services.live_link.prepare_update(context, target)


# In the order of registration.
CLASSES = (ZOOMOUT_OT_keep_linked, ZOOMOUT_OT_update_linked)
