# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview of an object by colours in the 3D views; `services.matching.previews` computes the colours.

There is one preview at a time. It belongs to one object, may colour others as well, and does not change the file. A
caption in the views names and explains it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import blf
import bpy
from bpy.types import Mesh, Object

from zoomout_core.arrays import Floats
from zoomout_core.messages import as_message, message

from ..translations import translated
from . import overlay
from .overlay import Overlay

CONFIDENCE, PLACES, CHECKER, CUT = "CONFIDENCE", "PLACES", "CHECKER", "CUT"
PAIRS, SIDES, ASYMMETRY = "PAIRS", "SIDES", "ASYMMETRY"
STRETCHED = "STRETCHED"
PRELIMINARY = "Preliminary: refined colors follow"
OUTDATED = "Hidden: a mesh was changed"
NOTHING_STRETCHES = "No vertex stretches far more than on the source"
LOST = "Hidden: the modifiers leave no faces to color"
HIDDEN = "Hidden in this mode; shown in Object Mode"
# Size of the caption, its distance from the lower border of a view, and the distance of its lines, in pixels at an
# interface scale of 1.
TEXT, BORDER, LINE = 13, 24, 20
# White with a dark shadow (its blur in pixels, and its colour) is legible on every background.
TEXT_COLOR, SHADOW = (1.0, 1.0, 1.0, 1.0), (3, 0.0, 0.0, 0.0, 0.8)


class Kind(NamedTuple):
    """A kind of preview.

    Attributes:
        label: label of its button.
        description: tooltip of its button.
        legend: the meaning of the colours.
    """

    label: str
    description: str
    legend: str


OF_MATCH = {
    CONFIDENCE: Kind(
        "Confidence",
        "Confidence of the match at each vertex: blue is certain, red is doubtful, and violet has no partner",
        "Blue: certain. Red: doubtful. Violet: no partner",
    ),
    PLACES: Kind(
        "Matching Colors",
        "Color each point of the source, and show the matched colors on the target",
        "Same color, same point",
    ),
    CHECKER: Kind("UV Checker", "Preview the source's active UV map on the target", "Preview of the source's UVs"),
    # Its button is beside Cut Along Seams.
    CUT: Kind(
        "Preview Cut",
        "Preview the source's active UV map on the target as Cut Along Seams would divide its faces",
        "Preview of the source's UVs after Cut Along Seams",
    ),
}
OF_BINDING = {
    STRETCHED: Kind(
        "Stretched",
        "Show where the bones of the rig stretch the mesh far more than the source",
        "Red: stretches far more than on the source",
    )
}
OF_SYMMETRY = {
    PAIRS: Kind(
        "Pairs",
        "Give corresponding points of the mesh the same color, paler on the right side",
        "Same color, same point; the right side is paler",
    ),
    SIDES: Kind(
        "Sides",
        "Show the left and the right side, and the middle as used by Name Sides",
        "Blue is left, orange is right, pale yellow the middle",
    ),
    ASYMMETRY: Kind("Asymmetry", "How much the two sides differ", "Blue is symmetric, red differs"),
}


@dataclass(frozen=True, eq=False)
class Preview:
    """A preview of an object.

    Attributes:
        kind: one of the kinds above.
        object_uid: `session_uid` of the object.
        legend: the meaning of the colours.
        overlays: the colours to draw.
        stored_hash: hash of the match or symmetry stored on the object's mesh, to detect a later one.
        passing: whether it was shown unasked, so that it ends when other objects are selected.
        preliminary: whether a match is still being refined, so that the preview ends with the work.
    """

    kind: str
    object_uid: int
    legend: str
    overlays: tuple[Overlay, ...]
    stored_hash: str
    passing: bool = False
    preliminary: bool = False

    def with_colors(self, colors: Floats) -> Preview:
        """The same preview with other colours (n, 3) on the object itself."""
        first, *others = self.overlays
        return replace(self, overlays=(replace(first, values=colors), *others))


_shown: Preview | None = None
# The preview that a preliminary one has replaced.
_before: Preview | None = None
_caption_handler: Any = None
# `session_uid` of the active and the selected objects when the preview was shown.
_selected: tuple[int, ...] = ()


def preview_of(obj: Object | None) -> Preview | None:
    """The current preview, if it belongs to an object."""
    return _shown if _shown is not None and obj is not None and _shown.object_uid == obj.session_uid else None


def legend(preview: Preview) -> str:
    """The meaning of the current preview's colours, or the reason why they are hidden."""
    if overlay.is_hidden():
        return HIDDEN
    if overlay.is_outdated():
        return OUTDATED
    return LOST if overlay.is_lost() else preview.legend


def current() -> Preview | None:
    """The current preview, of any object."""
    return _shown


def show(preview: Preview) -> None:
    """Show a preview, and no other."""
    global _shown, _selected, _caption_handler
    _shown, _selected = preview, _selection()
    overlay.show(preview.overlays)
    if _caption_handler is None:
        _caption_handler = bpy.types.SpaceView3D.draw_handler_add(_draw_caption, (), "WINDOW", "POST_PIXEL")


def show_preliminary(preview: Preview) -> None:
    """Show a preview until `end_preliminary`, or until another one is shown."""
    global _before
    if _shown is None or not _shown.preliminary:
        _before = _shown
    show(replace(preview, preliminary=True))


def end_preliminary() -> None:
    """Restore the previous preview if a preliminary one is still shown, such as after an error or a cancel."""
    if _shown is None or not _shown.preliminary:
        return
    if _before is None:
        clear()
    else:
        show(_before)


def clear() -> None:
    """Remove the preview."""
    global _shown, _before, _caption_handler
    _shown = _before = None
    overlay.clear()
    if _caption_handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_caption_handler, "WINDOW")
        _caption_handler = None


def caption() -> tuple[str, ...]:
    """The name of the current preview, the way to end it or its work, and its legend; empty if none is drawn."""
    if _shown is None or not overlay.visible():
        return ()
    name = as_message((OF_MATCH | OF_BINDING | OF_SYMMETRY)[_shown.kind].label)
    if _shown.preliminary:
        how_to_end = message("{preview}, preliminary: ESC cancels the match", preview=name)
    else:
        how_to_end = message("{preview}: the X in the tab ZoomOut hides the colors", preview=name)
    return translated(how_to_end), translated(legend(_shown))


def follow_selection() -> None:
    """Remove a passing preview once other objects are selected."""
    if _shown is not None and _shown.passing and _selection() != _selected:
        clear()


def _draw_caption() -> None:
    context, font = bpy.context, 0
    lines = caption() if context.space_data.overlay.show_overlays else ()
    if not lines:
        return
    scale = context.preferences.system.ui_scale
    blf.size(font, TEXT * scale)
    blf.color(font, *TEXT_COLOR)
    blf.enable(font, blf.SHADOW)
    blf.shadow(font, *SHADOW)
    for number, line in enumerate(lines):
        height = (BORDER + number * LINE) * scale
        blf.position(font, (context.region.width - blf.dimensions(font, line)[0]) / 2, height, 0)
        blf.draw(font, line)
    blf.disable(font, blf.SHADOW)


def _selection() -> tuple[int, ...]:
    objects = bpy.context.view_layer.objects
    active = [objects.active.session_uid] if objects.active else [0]
    return (*active, *sorted(obj.session_uid for obj in objects.selected))


def follow_edit(meshes: Iterable[Mesh]) -> None:
    """Remove the colours of an asymmetry if its mesh, or any data on it, was changed.

    The overlay itself hides other previews until the mesh is restored.
    """
    if _shown is None or _shown.kind != ASYMMETRY:
        return
    obj = overlay.find(_shown.object_uid)
    if obj is not None and obj.data.session_uid in {mesh.session_uid for mesh in meshes}:
        outdate(_shown)


def outdate(preview: Preview) -> None:
    """Replace a preview by a note that it is outdated, without colours."""
    show(replace(preview, legend=OUTDATED, overlays=()))
