"""Match two objects, and store the result on the target."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from bpy.types import Context, Object

from zoomout_core.runtime.stepping import Steps, drain, spread
from zoomout_core.runtime.threads import in_background

from ..scene.pair import check_unedited, read_pair_steps
from ..storage import stored_match
from ..viewport import preview
from . import previews
from .candidates import store_match
from .constraints import matching_steps, settings_to_store
from .redo_match import kept_match, read_mask, redone_match
from .targets import Write

NOTHING_KEPT = "There was no match to keep, so all of it was matched, not only what Redo Only says."


def match_objects(context: Context, source: Object, target: Object, **options: Any) -> stored_match.Match:
    """Match two mesh objects, and store the result on the target's mesh.

    Args:
        context: Blender's; both objects are in its scene.
        source: has the data; read as its modifiers leave it.
        target: receives the data.
        options: those of `prepare_match_steps`, of `constraints.matching_steps`, and of `zoomout_core.match`; or
            initial="nearest", and those of `zoomout_core.match_by_proximity`.

    Raises:
        MeshError: an object cannot be used; nothing was written.
    """
    return drain(match_steps(context, source.name, target.name, **options))


def match_steps(context: Context, source_name: str, target_name: str, **options: Any) -> Steps[stored_match.Match]:
    """`match_objects` as a generator, which holds no Blender data while it is suspended."""
    write = yield from prepare_match_steps(context, source_name, target_name, **options)
    return write()


def prepare_match_steps(
    context: Context,
    source_name: str,
    target_name: str,
    seen: bool = False,
    redo_group: str = "",
    redo_keeps: bool = False,
    **options: Any,
) -> Steps[Write[stored_match.Match]]:
    """`match_steps` without the writing: returns a function that stores the match on the target.

    Args:
        context: Blender's; both objects are in its scene.
        source_name: the object that has the data.
        target_name: the object that receives it.
        seen: whether places are shown by colours for a while, where nothing else is shown.
        redo_group: vertex group of the target where a match of the two that it has is replaced, and kept elsewhere;
            empty for everywhere.
        redo_keeps: whether it says the opposite, what is kept.
        options: those of `match_objects`.
    """
    pair = yield from read_pair_steps(context, source_name, target_name)
    settings = settings_to_store(context, pair, options)
    kept = kept_match(context, pair) if redo_group else None
    mask = read_mask(context, pair, redo_group, redo_keeps) if kept is not None else None
    result = yield from matching_steps(context, pair, **options)
    if kept is not None and mask is not None:
        blending = in_background(partial(redone_match, pair, kept, result, mask))
        result = yield from spread(blending, 1, 1, "Keeping the rest")
    elif redo_group:
        result = replace(result, notes=(NOTHING_KEPT, *result.notes))
    following = yield from previews.following_steps(context, pair, result, preview.PLACES if seen else None)

    def write() -> stored_match.Match:
        _, target = check_unedited(context, pair)
        store_match(target.data, result, pair, settings)
        if following is not None:
            preview.show(following)
        return result

    return write
