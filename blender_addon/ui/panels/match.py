# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of the match: objects, options, obstacles and the button."""

from __future__ import annotations

from typing import Any

from bpy.types import Context, Object, Panel, UILayout

from zoomout_core.matching.report.verdict import RED
from zoomout_core.messages import message
from zoomout_core.messages import sentences as join_sentences

from ... import services
from ...operators.matching.match import ZOOMOUT_OT_match
from ...presets import ZOOMOUT_PT_match_presets
from ...scene.selection import chosen_targets
from ...storage import stored_match
from ...translations import translated
from .. import manual
from .sidebar import (
    VERDICT_ICONS,
    SidebarPanel,
    count_text,
    elide,
    help_button,
    main_button,
    sentences,
    show_findings,
    split_properties,
)

# Share of the panel's width that Blender gives to the names of properties.
LABELS = 0.4


class ZOOMOUT_PT_match(SidebarPanel, Panel):
    bl_label = "Match"

    def draw_header_preset(self, context: Context) -> None:
        help_button(self.layout, manual.GUIDE)
        ZOOMOUT_PT_match_presets.draw_panel_header(self.layout)

    def draw(self, context: Context) -> None:
        layout, settings, target = self.layout, context.scene.zoomout, context.active_object
        split_properties(layout)
        column = layout.column()
        column.prop(settings, "source")
        is_mesh = target is not None and target.type == "MESH"
        source = services.preflight.likely_source(context) if is_mesh else None
        others = [obj for obj in chosen_targets(context, source) if obj != target] if source else []
        # The number of rows does not depend on the selection, so that no button moves.
        if settings.source is None:
            _object_row(column, _how_found(source, target), _name(context, source))
        _object_row(column, "Target", _describe_targets(context, target if is_mesh else None, len(others)))
        layout.prop(settings, "initial")
        if settings.initial == "FILE":
            layout.prop(settings, "map_file")
        if settings.initial not in ("NEAREST", "SAME_ORDER"):
            row = layout.row(align=True)
            row.use_property_split = False  # the three buttons need the full width
            row.prop(settings, "detail", expand=True)
        found = services.preflight.findings(context)
        show_findings(context, layout, [finding for finding in found if finding.blocks])
        stored = stored_match.description(target.data) if is_mesh else None
        main_button(
            layout,
            ZOOMOUT_OT_match.bl_idname,
            "Match Again"
            if stored is not None and not others
            else count_text("Match", "Match {count} Targets", context, source),
            "VIEWZOOM",
            not any(finding.blocks for finding in found),
        )
        if stored is not None:
            _draw_verdict(context, layout, stored)
        # Doubts are known only after an inspection of the meshes: they are below the button, which does not move then.
        show_findings(context, layout, [finding for finding in found if not finding.blocks])


def _draw_verdict(context: Context, layout: UILayout, stored: dict[str, Any]) -> None:
    """Draw whether to use the match, and what to do; nothing if it is outdated or not known."""
    verdict = stored_match.verdict_of(stored)
    if verdict is None or services.preflight.stale(context, context.active_object):
        return
    box = layout.box()
    box.alert = verdict.level == RED
    sentences(context, box, [join_sentences(verdict.sentence, verdict.advice)], VERDICT_ICONS[verdict.level])


def _how_found(source: Object | None, target: Object | None) -> str:
    """How the source was found that was not chosen in the panel; empty if there is none."""
    if source is None:
        return ""
    return "Selected" if source.select_get() and source != target else "Matched"


def _describe_targets(context: Context, target: Object | None, others: int) -> str:
    """The active target, and the number of other selected ones; empty if there is none."""
    if not others:
        return _name(context, target)
    return translated(message("{name} and {count} more", name=_name(context, target, 0.6), count=others))


def _name(context: Context, obj: Object | None, share: float = 1.0) -> str:
    """The name of an object, shortened to a share of the column of values; empty if there is no object."""
    return "" if obj is None else elide(context, obj.name, share * (1 - LABELS))


def _object_row(layout: UILayout, label: str, text: str) -> None:
    """Draw objects that were chosen elsewhere, aligned like a property."""
    split = layout.split(factor=LABELS)
    name = split.row()
    name.alignment = "RIGHT"
    name.label(text=label)
    split.label(
        text=text or translated("None selected"), translate=False, icon="OUTLINER_OB_MESH" if text else "BLANK1"
    )
