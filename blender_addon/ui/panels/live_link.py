# SPDX-License-Identifier: GPL-3.0-or-later
"""The subpanel of links, by which targets follow edits of their source."""

from __future__ import annotations

from collections.abc import Mapping

from bpy.types import Context, Panel

from zoomout_core.messages import Message, message, plural

from ... import services
from ...operators.live_link import ZOOMOUT_OT_keep_linked, ZOOMOUT_OT_update_linked
from ...operators.matching.match import ZOOMOUT_OT_match
from ...scene.selection import match_source
from ...storage import stored_link
from .sidebar import SidebarPanel, sentences
from .transfer import ZOOMOUT_PT_transfer


class ZOOMOUT_PT_live_link(SidebarPanel, Panel):
    bl_label = "Live Link"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 5

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active mesh was matched."""
        return bool(match_source(context, context.active_object))

    def draw(self, context: Context) -> None:
        layout, target = self.layout, context.active_object
        layout.operator(ZOOMOUT_OT_keep_linked.bl_idname, icon="LINKED")
        linked = stored_link.link_of(target)
        if linked is None:
            return
        if reason := services.preflight.stale(context, target):
            sentences(context, layout, [reason], "ERROR")
            layout.operator(ZOOMOUT_OT_match.bl_idname, text="Match Again")
        elif stored_link.has_older_match(target):
            sentences(context, layout, ["The mesh was matched again: update the link."], "INFO")
        layout.operator(ZOOMOUT_OT_update_linked.bl_idname, icon="FILE_REFRESH")
        sentences(context, layout, _follows(linked["layers"], linked["source"]), "DOT")


def _follows(layers: Mapping[str, float], source: str) -> list[Message]:
    """The share of each layer that follows the source; those that follow it wholly are only counted."""
    partly = {name: share for name, share in layers.items() if round(share, 2) < 1}
    wholly = len(layers) - len(partly)
    rows: list[tuple[str, float]] = [(plural(wholly, "{count} layer", "{count} layers"), 1.0)] if wholly else []
    return [
        message("{layer}: {share:.0%} follows '{source}'", layer=layer, share=share, source=source)
        for layer, share in [*rows, *partly.items()]
    ]
