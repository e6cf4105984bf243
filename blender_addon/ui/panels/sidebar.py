# SPDX-License-Identifier: GPL-3.0-or-later
"""Common parts of the sidebar's panels."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from bpy.types import Context, Object, UILayout

from zoomout_core.matching.notes import UNSURE
from zoomout_core.matching.verdict import AMBER, GREEN, RED, Verdict
from zoomout_core.messages import is_warning, message

from ...operators import activity
from ...operators.preview import ZOOMOUT_OT_clear_preview, ZOOMOUT_OT_preview
from ...operators.symmetry import ZOOMOUT_OT_check_symmetry
from ...scene.selection import chosen_targets, own_sources
from ...services.preflight import Finding
from ...translations import CONTEXT, translated
from ...viewport import preview
from .. import manual

# Width of a letter and of the border around a panel's text, in pixels at a scale of 1.
LETTER, BORDER = 6.5, 60
# Height of a panel's main button, relative to others.
BUTTON = 1.5
# Letters of a label that fits beside two others; number of lines of the longest legend.
NARROW, LEGEND = 12, 2
# Icons of verdicts on a match.
VERDICT_ICONS = {GREEN: "CHECKMARK", AMBER: "ERROR", RED: "CANCEL"}
# Size of the thumbnails of candidates, in icons.
PICTURE = 3.2


class SidebarPanel:
    """The base of the sidebar's panels."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ZoomOut"
    bl_translation_context = CONTEXT


def sentences(context: Context, layout: UILayout, texts: Sequence[str], icon: str = "NONE", lines: int = 0) -> None:
    """Draw sentences in the user's language, wrapped to the width of the panel.

    Each sentence may have an icon, and takes at least `lines` lines.
    """
    scale = context.preferences.system.ui_scale
    letters = max(20, int((context.region.width / scale - BORDER) / LETTER))
    for text in texts:
        column = layout.column(align=True)
        broken = textwrap.wrap(translated(text), letters)
        for number, line in enumerate(broken + [""] * (lines - len(broken))):
            column.label(text=line, translate=False, icon=icon if number == 0 or icon == "NONE" else "BLANK1")


def draw_notes(context: Context, layout: UILayout, notes: Sequence[str], verdict: Verdict | None = None) -> None:
    """Draw notes on a result, first those that ask the user to check or do something.

    Those that repeat the certainty in a `verdict` that is shown, too, are left out.
    """
    if verdict is not None:
        notes = [note for note in notes if getattr(note, "template", None) != UNSURE]
    for warns, icon in ((True, "ERROR"), (False, "DOT")):
        sentences(context, layout, [note for note in notes if is_warning(note) == warns], icon)


def show_findings(context: Context, layout: UILayout, found: Sequence[Finding]) -> None:
    """Draw obstacles or doubts."""
    for finding in found:
        if finding.begins:
            sentences(context, layout, [finding.text], "INFO")
            continue
        box = layout.box()
        box.alert = finding.blocks
        sentences(context, box, [finding.text], "ERROR" if finding.blocks else "INFO")


def preview_buttons(
    context: Context, layout: UILayout, kinds: Mapping[str, preview.Kind], nothing: str, enabled: bool = True
) -> None:
    """Draw a button for each preview of the active object, and below them the legend, or that there is `nothing`.

    The button that removes a preview is always enabled. The height is constant, so that no button moves.
    """
    shown = preview.preview_of(context.active_object)
    if shown is not None and shown.kind not in kinds:
        shown = None
    column = layout.column(align=True)
    wide = column.column(align=True)
    whole = column.row(align=True)
    narrow = whole.row(align=True)
    wide.enabled = narrow.enabled = enabled
    for name, kind in kinds.items():
        row = wide if len(kind.label) > NARROW else narrow
        pressed = shown is not None and shown.kind == name
        if name == preview.ASYMMETRY:
            row.operator(ZOOMOUT_OT_check_symmetry.bl_idname, text=kind.label, depress=pressed)
        else:
            row.operator(ZOOMOUT_OT_preview.bl_idname, text=kind.label, depress=pressed).kind = name
    whole.operator(ZOOMOUT_OT_clear_preview.bl_idname, text="", icon="X")
    sentences(context, layout, [preview.legend(shown) if shown else nothing], lines=LEGEND)


def main_button(layout: UILayout, operator: str, text: str, icon: str, enabled: bool) -> None:
    """Draw the main button of a panel, or the progress of a running operator."""
    row = layout.row()
    row.scale_y = BUTTON
    if activity.running is not None:
        split = row.split(factor=0.72)
        split.progress(text=translated(activity.running.stage), factor=activity.running.fraction)
        split.label(text="ESC", icon="CANCEL")
        return
    row.enabled = enabled
    row.operator(operator, text=text, icon=icon)


def count_text(one: str, several: str, context: Context, source: Object | None) -> str:
    """The text of a button for one target, or for several with their number."""
    number = len(own_sources(context)) or (len(chosen_targets(context, source)) if source else 1)
    return translated(message(several, count=number)) if number > 1 else one


def help_button(layout: UILayout, page: str) -> None:
    """Draw a button that opens a page of the guide, in the header of a panel."""
    row = layout.row()
    row.emboss = "NONE"
    row.operator("wm.url_open", text="", icon="HELP").url = manual.address(page)


def split_properties(layout: UILayout) -> None:
    """Draw names to the left of values, without the dots for animation."""
    layout.use_property_split = True
    layout.use_property_decorate = False
