# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of the transfer: obstacles, the button, the source's data, and the report."""

from __future__ import annotations

from bpy.types import Context, Object, Panel, UILayout

from zoomout_core.matching.report.verdict import GREEN, select_notes
from zoomout_core.messages import as_message, message

from ... import services
from ...operators.choose_data import ZOOMOUT_OT_choose_data
from ...operators.transfer import ZOOMOUT_OT_transfer
from ...presets import ZOOMOUT_PT_transfer_presets
from ...properties.transfer import TransferOptions
from ...scene.selection import match_source, own_sources
from ...storage import stored_match
from ...storage.stored_report import transfer_report
from .. import manual
from .sidebar import (
    VERDICT_ICONS,
    SidebarPanel,
    count_text,
    draw_notes,
    help_button,
    main_button,
    sentences,
    show_findings,
)


class ZOOMOUT_PT_transfer(SidebarPanel, Panel):
    bl_label = "Transfer"

    def draw_header_preset(self, context: Context) -> None:
        help_button(self.layout, manual.RULES)
        ZOOMOUT_PT_transfer_presets.draw_panel_header(self.layout)

    def draw(self, context: Context) -> None:
        layout, target = self.layout, context.active_object
        source, own = services.preflight.likely_source(context) if target else None, own_sources(context)
        if source is None and target is not None and target.name in own:
            source = context.scene.objects[own[target.name]]
        # The panel of the match, above, shows mere doubts about the meshes.
        found = [finding for finding in services.preflight.findings(context) if finding.blocks]
        matched = bool(own) or (source is not None and match_source(context, target) == source.name)
        known = [context.scene.objects[name] for name in own] or [target] * matched
        if reasons := [reason for obj in known if (reason := services.preflight.stale(context, obj))]:
            found = [services.preflight.Finding(reason, True) for reason in reasons]
        elif matched:
            found += [
                services.preflight.Finding(text, False)
                for obj in known
                for text in services.preflight.find_outdated(context, obj)
            ]
        show_findings(context, layout, found)
        if matched:
            text = count_text("Transfer", "Transfer to {count} Targets", context, source)
        else:
            text = count_text("Match and Transfer", "Match and Transfer to {count} Targets", context, source)
        free = not any(finding.blocks for finding in found)
        # The button is above the choice, as in Blender's Bake panel, so that both fit a screen after a match.
        main_button(layout, ZOOMOUT_OT_transfer.bl_idname, text, "PASTEDOWN", free)
        _draw_choice(layout, context, source)


class ZOOMOUT_PT_report(SidebarPanel, Panel):
    bl_label = "Report"
    bl_parent_id = ZOOMOUT_PT_transfer.__name__
    bl_order = 0

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether there was a transfer."""
        target = context.active_object
        return target is not None and target.type == "MESH" and transfer_report(target) is not None

    def draw(self, context: Context) -> None:
        report = transfer_report(context.active_object)
        if report is None:
            return
        verdict = stored_match.verdict_of(report)
        sentences(
            context,
            self.layout,
            [services.transfer_report.summary(report)],
            VERDICT_ICONS[GREEN if verdict is None else verdict.level],
        )
        if verdict is not None and verdict.level != GREEN:
            sentences(context, self.layout, [verdict.sentence, verdict.advice], "BLANK1")
        skipped = [
            message("{name}: skipped, {reason}", name=name, reason=as_message(reason))
            for name, reason in report["skipped"].items()
        ]
        sentences(context, self.layout, skipped, "CANCEL")
        draw_notes(context, self.layout, select_notes(report["notes"], verdict))


def _draw_choice(layout: UILayout, context: Context, source: Object | None) -> None:
    """Draw a check box for each kind of data with the source's count; kinds that have no effect are disabled."""
    settings, counts = context.scene.zoomout, services.inventory.inventory(context, source) if source else {}
    row = layout.row(align=True)
    for text, every in (("All", True), ("None", False)):
        row.operator(ZOOMOUT_OT_choose_data.bl_idname, text=text).every = every
    column = layout.column(align=True)
    for name in TransferOptions.__annotations__:
        row = column.row()
        # Seams are marked between islands of UVs, too.
        row.enabled = counts.get(name) != 0 or (name == "edges" and settings.uv_maps and counts.get("uv_maps") != 0)
        row.prop(settings, name)
        number = row.row()
        number.alignment = "RIGHT"
        number.label(text=str(counts.get(name, "")))
