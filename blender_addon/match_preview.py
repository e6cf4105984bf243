"""Which colours show a match: how far it is to be trusted, which place belongs where, or how UVs will lie."""

from __future__ import annotations

from bpy.types import Context, Object

from zoomout_core.progress import Progress, Steps, spread
from zoomout_core.transfer import drape, transfer_steps

from . import overlay
from .colors import confidence_colors, place_colors
from .mesh_data import read_active_uv_map
from .overlay import Coat
from .pair import ObjectPair, find_mesh, source_mesh
from .stored_match import Match

CONFIDENCE, PLACES, CHECKER = "CONFIDENCE", "PLACES", "CHECKER"

_kind = ""


def shown_kind(target: Object | None) -> str:
    """Which preview of a target is shown; none, if it is one of another."""
    coats = overlay.shown()
    return _kind if coats and target is not None and coats[0].object_name == target.name else ""


def show(kind: str, coats: tuple[Coat, ...]) -> None:
    """Show a preview."""
    global _kind
    _kind = kind
    overlay.show(coats)


def coats_steps(context: Context, pair: ObjectPair, match: Match, kind: str) -> Steps[tuple[Coat, ...]]:
    """The coats of a preview: the target's, and the source's where it is coloured as well.

    Raises:
        MeshError: for a checker, the source has no UV map.
    """
    yield Progress(0.0, "Colouring")
    if kind == CONFIDENCE:
        return (Coat(pair.target_name, confidence_colors(match.confidence)),)
    if kind == PLACES:
        colors = place_colors(pair.source.vertices, pair.source.vertices)
        there = match.surface_map.interpolate(colors)
        return Coat(pair.target_name, there), Coat(pair.source_name, colors)
    with source_mesh(context, pair) as (evaluated, mesh):
        uv = read_active_uv_map(evaluated, mesh)
    carrying = transfer_steps(uv, drape(match, pair.source, pair.target))
    carried = yield from spread(carrying, 0.1, 1, "Laying the checker")
    return Coat(pair.target_name, carried.values), Coat(pair.source_name, uv.values)


def following_steps(context: Context, pair: ObjectPair, match: Match) -> Steps[tuple[Coat, ...]]:
    """The coats of the preview that is shown of a target, for a new match of it; none where there is no preview."""
    kind = shown_kind(find_mesh(context, pair.target_name))
    if not kind:
        return ()
    return (yield from coats_steps(context, pair, match, kind))


def follow(coats: tuple[Coat, ...]) -> None:
    """Show new coats, if there are any, in the preview that is shown."""
    if coats:
        overlay.show(coats)
