# SPDX-License-Identifier: GPL-3.0-or-later
"""Match two objects, and store the result on the target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.collection.agree import agree
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.runtime.progress import stage

from ...jobs import compute, run
from ...mesh_data import ObjectPair
from ...scene.pair import name_of, read_pair, writing
from ...storage import stored_match
from ...viewport import preview
from . import previews
from .bone_match import correct_match
from .candidates import store_match
from .pair_match import match_pair, settings_to_store
from .redo_match import read_mask, redone_match, valid_match

NOTHING_KEPT = "There was no match to keep, so the whole target was matched, not only the Redo Only group."


def match_objects(context: Context, source: Object, target: Object, **options: Any) -> stored_match.Match:
    """Match two mesh objects, and store the result on the target's mesh.

    Args:
        context: Blender's; both objects are in its scene.
        source: the object with the data; it is read after its modifiers.
        target: the object that receives the data.
        options: options of `prepare_match`, `constraints.match_pair` and `zoomout_core.match`; or initial="nearest",
            and options of `zoomout_core.match_by_proximity`.

    Raises:
        MeshError: an object cannot be used; nothing was written.
    """
    return run(match(context, name_of(source), name_of(target), **options))


async def match(context: Context, source_name: str, target_name: str, **options: Any) -> stored_match.Match:
    """`match_objects` as a coroutine, which keeps no Blender data across an `await`."""
    write = await prepare_match(context, source_name, target_name, **options)
    return write()


async def prepare_match(
    context: Context,
    source_name: str,
    target_name: str,
    show_preview: bool = False,
    redo_group: str = "",
    redo_keeps: bool = False,
    **options: Any,
) -> PreparedMatch:
    """`match` without writing: returns a callable that stores the match on the target.

    Args:
        context: Blender's; both objects are in its scene.
        source_name: name of the source.
        target_name: name of the target.
        show_preview: whether to show a passing preview of places if there is no other preview.
        redo_group: vertex group of the target where a stored match of the two is replaced, and kept elsewhere; empty to
            replace all of it.
        redo_keeps: whether the group is kept instead, and the rest replaced.
        options: options of `match_objects`.
    """
    pair = await read_pair(context, source_name, target_name)
    settings = settings_to_store(context, pair, options)
    kept = valid_match(context, pair) if redo_group else None
    mask = read_mask(context, pair, redo_group, redo_keeps) if kept is not None else None
    with previews.first_look(context, pair, show_preview):
        result = await match_pair(context, pair, **options)
    if kept is not None and mask is not None:
        with stage("Merging with the previous match", 1, 1):
            result = await compute(partial(redone_match, pair, kept, result, mask))
    elif redo_group:
        result = replace(result, notes=(NOTHING_KEPT, *result.notes))
    return await _prepare(context, pair, result, settings, show_preview)


@dataclass(frozen=True, eq=False)
class PreparedMatch:
    """A computed match; a call stores it on the target and returns it.

    Attributes:
        context: Blender's.
        pair: the two objects, as they were read.
        result: the match.
        settings: the settings to store with it.
        show_preview: whether to show a passing preview of places.
        new_preview: the preview of the match, or None.
    """

    context: Context
    pair: ObjectPair
    result: stored_match.Match
    settings: dict[str, Any]
    show_preview: bool
    new_preview: previews.Preview | None

    def __call__(self) -> stored_match.Match:
        with writing(self.context, self.pair) as (_, target):
            store_match(target.data, self.result, self.pair, self.settings)
        if self.new_preview is not None:
            preview.show(self.new_preview)
        return self.result


async def _prepare(
    context: Context, pair: ObjectPair, result: stored_match.Match, settings: dict[str, Any], show_preview: bool
) -> PreparedMatch:
    new_preview = await previews.updated_preview(context, pair, result, preview.PLACES if show_preview else None)
    return PreparedMatch(context, pair, result, settings, show_preview, new_preview)


async def agree_matches(detail: str, k_final: int, prepared: Mapping[str, PreparedMatch]) -> dict[str, PreparedMatch]:
    """Reconcile matches of several targets that have the same source, see `collection.agree`.

    Args:
        detail: detail of the matches between targets, one of `DETAIL`.
        k_final: size of their functional maps; 0 for that of `detail`.
        prepared: the matches, by the names of the targets.
    """
    sizes = zo.MatchOptions(**resolve_detail(detail, k_final))
    agreed = dict(prepared)
    for source in dict.fromkeys(each.pair.source_names for each in prepared.values()):
        results = {
            name: each.result
            for name, each in prepared.items()
            if each.pair.source_names == source and isinstance(each.result, zo.MatchResult)
        }
        for name, result in (await compute(partial(agree, results, sizes))).items():
            was = prepared[name]
            if result is not was.result:
                result = await correct_match(was.context, was.pair, result)
                agreed[name] = await _prepare(was.context, was.pair, result, was.settings, was.show_preview)
    return agreed
