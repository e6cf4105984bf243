# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview in the 3D views: what is shown of an object by colours. What it shows is computed in `services.previews`.

There is one preview at a time. It belongs to one object, and may colour others as well; the file stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import bpy
from bpy.types import Mesh, Object

from zoomout_core.arrays import Floats

from . import overlay
from .overlay import Overlay

CONFIDENCE, PLACES, CHECKER = "CONFIDENCE", "PLACES", "CHECKER"
PAIRS, SIDES, ASYMMETRY = "PAIRS", "SIDES", "ASYMMETRY"
OUTDATED = "Hidden: a mesh was changed"
LOST = "Hidden: the modifiers leave no faces to color"
HIDDEN = "Hidden in this mode; shown in Object Mode"


class Kind(NamedTuple):
    """What a preview shows.

    Attributes:
        label: of its button.
        description: of it.
        legend: what the colours mean.
    """

    label: str
    description: str
    legend: str


OF_MATCH = {
    CONFIDENCE: Kind(
        "Confidence",
        "Confidence of the match at each vertex: blue is high, red is low, and violet has no partner",
        "Blue is high, red is low, violet has no partner",
    ),
    PLACES: Kind(
        "Matching Colors",
        "Color each point of the source, and show the matched colors on the target",
        "Same color, same point",
    ),
    CHECKER: Kind("UV Checker", "Preview the source's active UV map on the target", "Preview of the source's UVs"),
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
    """Something that is shown.

    Attributes:
        kind: one of those above.
        object_uid: the session's number of the object that it is of.
        legend: what the colours mean.
        overlays: what is drawn.
        stored_hash: hash of the match or symmetry stored on the object's mesh, by which a later one is noticed.
        passing: whether it was not asked for, and goes when other objects are selected, or data is transferred.
    """

    kind: str
    object_uid: int
    legend: str
    overlays: tuple[Overlay, ...]
    stored_hash: str
    passing: bool = False

    def with_colors(self, colors: Floats) -> Preview:
        """The same with other colours (n, 3) on the object itself."""
        first, *others = self.overlays
        return replace(self, overlays=(replace(first, values=colors), *others))


_shown: Preview | None = None
# The active object and the selected ones when it was shown, by their `session_uid`.
_selected: tuple[int, ...] = ()


def preview_of(obj: Object | None) -> Preview | None:
    """What is shown of an object."""
    return _shown if _shown is not None and obj is not None and _shown.object_uid == obj.session_uid else None


def legend(preview: Preview) -> str:
    """What the colours of the preview that is shown mean, or that they are hidden."""
    if overlay.is_hidden():
        return HIDDEN
    if overlay.is_outdated():
        return OUTDATED
    return LOST if overlay.is_lost() else preview.legend


def current() -> Preview | None:
    """The preview that is shown, of any object."""
    return _shown


def show(preview: Preview) -> None:
    """Show a preview, in place of another one."""
    global _shown, _selected
    _shown, _selected = preview, _selection()
    overlay.show(preview.overlays)


def clear() -> None:
    """Show nothing."""
    global _shown
    _shown = None
    overlay.clear()


def clear_passing() -> None:
    """Show nothing that was not asked for."""
    if _shown is not None and _shown.passing:
        clear()


def follow_selection() -> None:
    """Show nothing that was not asked for once other objects are selected."""
    if _shown is not None and _shown.passing and _selection() != _selected:
        clear()


def _selection() -> tuple[int, ...]:
    objects = bpy.context.view_layer.objects
    active = [objects.active.session_uid] if objects.active else [0]
    return (*active, *sorted(obj.session_uid for obj in objects.selected))


def follow_edit(meshes: Iterable[Mesh]) -> None:
    """Take the colours of an asymmetry away where its mesh, or anything on it, was changed since it was measured.

    Other previews are hidden by the overlay, until the mesh is what it was.
    """
    if _shown is None or _shown.kind != ASYMMETRY:
        return
    obj = overlay.find(_shown.object_uid)
    if obj is not None and obj.data.session_uid in {mesh.session_uid for mesh in meshes}:
        outdate(_shown)


def outdate(preview: Preview) -> None:
    """Replace a preview by the sentence that it is outdated, without colours."""
    show(replace(preview, legend=OUTDATED, overlays=()))
