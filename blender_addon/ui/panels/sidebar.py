"""What the panels of the sidebar have in common."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from bpy.app.translations import pgettext_iface
from bpy.types import Context, Object, UILayout

from ...operators import activity
from ...operators.preview import ZOOMOUT_OT_clear_preview, ZOOMOUT_OT_preview
from ...operators.symmetry import ZOOMOUT_OT_check_symmetry
from ...scene.selection import chosen_targets
from ...services.preflight import Finding
from ...translations import CONTEXT
from ...viewport import preview
from .. import manual

# Width of a letter and of the border around a panel's text, in pixels at the interface's normal scale.
LETTER, BORDER = 6.5, 60
# The button of a panel is taller than what it depends on.
BUTTON = 1.5
# Size of the thumbnails of candidates, in icons.
PICTURE = 3.2


class SidebarPanel:
    """What the panels have in common."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ZoomOut"
    bl_translation_context = CONTEXT


def sentences(context: Context, layout: UILayout, texts: Sequence[str], icon: str = "NONE") -> None:
    """Text, broken into lines that fit the panel; each sentence may begin with an icon."""
    scale = context.preferences.system.ui_scale
    letters = max(20, int((context.region.width / scale - BORDER) / LETTER))
    for text in texts:
        column = layout.column(align=True)
        for number, line in enumerate(textwrap.wrap(text, letters)):
            column.label(text=line, icon=icon if number == 0 or icon == "NONE" else "BLANK1")


def show_findings(context: Context, layout: UILayout, found: Sequence[Finding]) -> None:
    """Obstacles and doubts, above the button that they concern."""
    for finding in found:
        box = layout.box()
        box.alert = finding.blocks
        sentences(context, box, [finding.text], "ERROR" if finding.blocks else "INFO")


def preview_buttons(
    context: Context, layout: UILayout, kinds: Mapping[str, preview.Kind], enabled: bool = True
) -> None:
    """What can be shown of the active object in the viewport, below what the colours that are shown mean.

    Whatever is enabled, colours can be taken away.
    """
    shown = preview.shown(context.active_object)
    if shown is not None and shown.kind not in kinds:
        shown = None
    legend = preview.legend(shown) if shown else "Show in the viewport:"
    sentences(context, layout, [legend])
    whole = layout.row(align=True)
    row = whole.row(align=True)
    row.enabled = enabled
    for name, kind in kinds.items():
        pressed = shown is not None and shown.kind == name
        if name == preview.ASYMMETRY:
            row.operator(ZOOMOUT_OT_check_symmetry.bl_idname, text=kind.label, depress=pressed)
        else:
            row.operator(ZOOMOUT_OT_preview.bl_idname, text=kind.label, depress=pressed).kind = name
    whole.operator(ZOOMOUT_OT_clear_preview.bl_idname, text="", icon="X")


def main_button(layout: UILayout, operator: str, text: str, icon: str, enabled: bool) -> None:
    """The main button of a panel; while an operator is running, its progress."""
    if activity.running is not None:
        layout.progress(text=activity.running.stage, factor=activity.running.fraction)
        layout.label(text="ESC cancels", icon="X")
        return
    row = layout.row()
    row.scale_y = BUTTON
    row.enabled = enabled
    row.operator(operator, text=text, icon=icon)


def counted(one: str, several: str, context: Context, source: Object | None) -> str:
    """The text of a button for one target, or that for several, in which their number is put."""
    number = len(chosen_targets(context, source)) if source else 1
    return pgettext_iface(several, CONTEXT).format(number) if number > 1 else one


def help_button(layout: UILayout, page: str) -> None:
    """A button that opens a page of the guide, in the header of a panel."""
    row = layout.row()
    row.emboss = "NONE"
    row.operator("wm.url_open", text="", icon="HELP").url = manual.address(page)


def split_properties(layout: UILayout) -> None:
    """Names to the left, values to the right, and no dots to animate them by."""
    layout.use_property_split = True
    layout.use_property_decorate = False
