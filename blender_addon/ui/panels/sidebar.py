# SPDX-License-Identifier: GPL-3.0-or-later
"""Common parts of the sidebar's panels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import blf
from bpy.types import Context, Object, UILayout

from zoomout_core.matching.report.verdict import AMBER, GREEN, RED
from zoomout_core.messages import is_warning, message

from ... import services
from ...operators.base import activity
from ...operators.preview import ZOOMOUT_OT_clear_preview, ZOOMOUT_OT_preview
from ...operators.symmetry import ZOOMOUT_OT_check_symmetry
from ...scene.selection import chosen_targets, own_sources
from ...translations import CONTEXT, translated
from ...viewport import preview
from .. import manual

# Widths of the border around a panel's text in a box, of a panel's margins, and of the icon and padding of a label, in
# pixels at a scale of 1; and the font of labels.
BORDER, MARGIN, ICON, FONT = 86, 48, 34, 0
# Height of a panel's main button, relative to others.
BUTTON = 1.5
# Letters of a label that fits beside two others.
NARROW = 12
# Icons of verdicts on a match.
VERDICT_ICONS = {GREEN: "CHECKMARK", AMBER: "ERROR", RED: "CANCEL"}


class SidebarPanel:
    """The base of the sidebar's panels."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ZoomOut"
    bl_translation_context = CONTEXT


def sentences(context: Context, layout: UILayout, texts: Sequence[str], icon: str = "NONE") -> None:
    """Draw sentences in the user's language, wrapped to the width of the panel; each may have an icon."""
    width = context.region.width - BORDER * _set_font(context)
    for text in texts:
        column = layout.column(align=True)
        for number, line in enumerate(_wrap(translated(text), width)):
            column.label(text=line, translate=False, icon=icon if number == 0 or icon == "NONE" else "BLANK1")


def elide(context: Context, text: str, share: float = 1.0) -> str:
    """Leave out the middle of a text that is wider than a share of the panel: names often differ at their ends only.

    Blender cuts off the ends of labels.
    """
    scale = _set_font(context)
    width = share * (context.region.width - MARGIN * scale) - ICON * scale
    short, kept = text, len(text) - 1
    while kept > 1 and not _fits(short, width):
        short = f"{text[: (kept + 1) // 2]}…{text[len(text) - kept // 2 :]}"
        kept -= 1
    return short


def _set_font(context: Context) -> float:
    """Set the font in which texts are measured to that of labels; returns the scale of the interface."""
    scale = float(context.preferences.system.ui_scale)
    blf.size(FONT, context.preferences.ui_styles[0].widget.points * scale)
    return scale


def _wrap(text: str, width: float) -> list[str]:
    """Break text into lines of at most a width in pixels: between words, or within one that is too long itself."""
    lines = [""]
    for word in text.split():
        begun = f"{lines[-1]} ".lstrip()
        if _fits(begun + word, width):
            lines[-1] = begun + word
        elif _fits(word, width):
            lines.append(word)
        else:
            lines[-1] = begun
            for letter in word:
                if lines[-1] and not _fits(lines[-1] + letter, width):
                    lines.append("")
                lines[-1] += letter
    return [line for line in lines if line]


def _fits(text: str, width: float) -> bool:
    return bool(blf.dimensions(FONT, text)[0] <= width)


def draw_notes(context: Context, layout: UILayout, notes: Sequence[str]) -> None:
    """Draw notes on a result, first those that ask the user to check or do something."""
    for warns, icon in ((True, "ERROR"), (False, "DOT")):
        sentences(context, layout, [note for note in notes if is_warning(note) == warns], icon)


def show_findings(context: Context, layout: UILayout, found: Sequence[services.preflight.Finding]) -> None:
    """Draw obstacles or doubts."""
    for finding in found:
        if finding.begins:
            sentences(context, layout, [finding.text], "INFO")
            continue
        box = layout.box()
        box.alert = finding.blocks
        sentences(context, box, [finding.text], "ERROR" if finding.blocks else "INFO")


def preview_buttons(
    context: Context, layout: UILayout, kinds: Mapping[str, preview.Kind], enabled: bool = True
) -> None:
    """Draw a button for each preview of the active object; the button that removes a preview is always enabled."""
    shown = _shown_of(context, kinds)
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


def explain_hidden_preview(context: Context, layout: UILayout, kinds: Mapping[str, preview.Kind]) -> None:
    """Draw why the colors of a preview are hidden; the caption of the 3D views explains those that are shown."""
    shown = _shown_of(context, kinds)
    if shown is not None and not preview.caption():
        sentences(context, layout, [preview.legend(shown)], "INFO")


def _shown_of(context: Context, kinds: Mapping[str, preview.Kind]) -> preview.Preview | None:
    """The preview of the active object, if it is of one of some kinds."""
    shown = preview.preview_of(context.active_object)
    return shown if shown is not None and shown.kind in kinds else None


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
