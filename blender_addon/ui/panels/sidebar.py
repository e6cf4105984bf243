# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels of the sidebar have in common."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from bpy.types import Context, Object, UILayout

from zoomout_core.messages import message

from ...operators import activity
from ...operators.preview import ZOOMOUT_OT_clear_preview, ZOOMOUT_OT_preview
from ...operators.symmetry import ZOOMOUT_OT_check_symmetry
from ...scene.selection import chosen_targets, own_sources
from ...services.preflight import Finding
from ...translations import CONTEXT, translated
from ...viewport import preview
from .. import manual

# Width of a letter and of the border around a panel's text, in pixels at the interface's normal scale.
LETTER, BORDER = 6.5, 60
# The button of a panel is taller than what it depends on.
BUTTON = 1.5
# Letters of a label that fits beside two others; lines that the longest legend takes.
NARROW, LEGEND = 12, 2
NOTHING_SHOWN = "No preview is shown"
# Size of the thumbnails of candidates, in icons.
PICTURE = 3.2


class SidebarPanel:
    """What the panels have in common."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ZoomOut"
    bl_translation_context = CONTEXT


def sentences(context: Context, layout: UILayout, texts: Sequence[str], icon: str = "NONE", lines: int = 0) -> None:
    """Text in the user's language, broken into lines that fit the panel.

    Each sentence may begin with an icon, and has some lines at least.
    """
    scale = context.preferences.system.ui_scale
    letters = max(20, int((context.region.width / scale - BORDER) / LETTER))
    for text in texts:
        column = layout.column(align=True)
        broken = textwrap.wrap(translated(text), letters)
        for number, line in enumerate(broken + [""] * (lines - len(broken))):
            column.label(text=line, translate=False, icon=icon if number == 0 or icon == "NONE" else "BLANK1")


def show_findings(context: Context, layout: UILayout, found: Sequence[Finding]) -> None:
    """Obstacles and doubts, above the button that they concern."""
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
    """What can be shown of the active object in the viewport, above what the colours that are shown mean.

    Whatever is enabled, colours can be taken away. The height stays, whatever is shown: no button moves away.
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
    sentences(context, layout, [preview.legend(shown) if shown else NOTHING_SHOWN], lines=LEGEND)


def main_button(layout: UILayout, operator: str, text: str, icon: str, enabled: bool) -> None:
    """The main button of a panel; while an operator is running, its progress."""
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
    """The text of a button for one target, or that for several, in which their number is put."""
    number = len(own_sources(context)) or (len(chosen_targets(context, source)) if source else 1)
    return translated(message(several, count=number)) if number > 1 else one


def help_button(layout: UILayout, page: str) -> None:
    """A button that opens a page of the guide, in the header of a panel."""
    row = layout.row()
    row.emboss = "NONE"
    row.operator("wm.url_open", text="", icon="HELP").url = manual.address(page)


def split_properties(layout: UILayout) -> None:
    """Names to the left, values to the right, and no dots to animate them by."""
    layout.use_property_split = True
    layout.use_property_decorate = False
