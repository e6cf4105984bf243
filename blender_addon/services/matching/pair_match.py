# SPDX-License-Identifier: GPL-3.0-or-later
"""Match two objects by their shapes and by hints, or as their options say."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import fields, replace
from functools import partial
from inspect import signature
from typing import Any

import numpy as np
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.matching.pair import LandmarkError
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.matching.report.part_report import name_components, notes_on_parts
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage

from ... import mesh_data
from ...jobs import compute, pause
from ...mesh_data import ObjectPair
from ...scene.landmarks import OF_LANDMARKS, landmarks_fingerprint
from ...scene.pair import find_mesh
from ...storage import stored_match
from ...storage.stored_match import Match
from .bone_match import correct_match
from .half_match import HalfResult
from .hints import Hints, arguments_of_hints, landmarks_of_pair
from .initial_maps import map_of_file, same_order
from .parts import read_parts

# From this part of the area of named regions on that the map takes elsewhere, a note warns the user.
CONTRADICTION = 0.6
# Options that refer to the target's vertices by number.
OF_VERTICES = frozenset({"regions", "initial_map"})


async def match_pair(
    context: Context, pair: ObjectPair, map_file: str = "", detail: str = "balanced", k_final: int = 0, **options: Any
) -> Match:
    """`zoomout_core.match` with the hints from two objects, which the result's notes list.

    With initial="nearest" it is `zoomout_core.match_by_proximity`, and with "same_order" each vertex maps to the one of
    the same number; neither uses hints. With "landmarks" only the landmarks are hints, and with "file" there are none:
    the match starts from `map_file`.

    Args:
        context: Blender's; both objects are in its scene.
        pair: the two, as they are now.
        map_file: a map that `zoomout match` wrote.
        detail: one of `DETAIL`.
        k_final: size of the final functional map; 0 for that of `detail`.
        options: the `Hints`, and options of `zoomout_core.match`, or of `zoomout_core.match_by_proximity`.

    Raises:
        MeshError: see `zoomout_core.match`; or there are no landmarks to start from, or the map file does not exist.
    """
    initial = options.pop("initial", "auto")
    hints = Hints(**{each.name: options.pop(each.name) for each in fields(Hints) if each.name in options})
    if initial == "nearest":
        return await compute(partial(zo.match_by_proximity, pair.source, pair.target, **options))
    if initial == "same_order":
        with stage("Comparing the order"):
            return await compute(partial(same_order, pair))
    arguments = resolve_detail(detail, k_final, initial=initial)
    if initial == "file":
        arguments |= {"initial": "given", "initial_map": map_of_file(pair, map_file)}
    if "landmarks" in options:
        hints = replace(hints, use_landmarks=False)
    landmarks = landmarks_of_pair(context, pair, initial, hints.use_landmarks)
    notes = list(landmarks.notes)
    if landmarks.numbers:
        arguments["landmarks"] = landmarks.source, landmarks.target
    if hints.exact_landmarks and "landmarks" in arguments | options:
        arguments["exact_landmarks"] = True
    whole = _whole_target(context, pair) if initial in OF_LANDMARKS and not OF_VERTICES & options.keys() else None
    if whole is not None:  # names and the last match refer to vertices of the half
        hints = replace(hints, names=False, from_last=False)
    if initial == "auto":
        of_hints, notes_on_hints = await arguments_of_hints(context, pair, hints, len(landmarks.numbers))
        arguments |= of_hints
        notes = notes_on_hints + notes
    await pause()
    parts = read_parts(context, pair)
    result = await _match(pair, pair.target if whole is None else whole, arguments | options, landmarks.numbers)
    if _contradicts_names(result, arguments.get("regions", ())):
        notes.append(
            "The map contradicts most names that the two objects share: check whether names or sides are swapped."
        )
    result, on_parts = name_components(result, parts), notes_on_parts(result, parts)
    if whole is not None:
        notes.append(
            message(
                "'{target}' was matched together with the half created by its Mirror modifier.", target=pair.target_name
            )
        )
        result = HalfResult.of(result, pair.target)
    result = await correct_match(context, pair, result)
    return replace(result, notes=(*notes, *on_parts, *result.notes))


async def _match(
    pair: ObjectPair, target: zo.Surface, arguments: dict[str, Any], numbers: Sequence[int]
) -> zo.MatchResult:
    """`zoomout_core.match`, whose errors name landmarks by the user's numbers, if these are known."""
    try:
        return await compute(partial(zo.match, pair.source, target, **arguments))
    except LandmarkError as error:
        raise zo.MeshError(
            "Landmark {number} on '{name}', {fault}",
            number=numbers[error.number] if numbers else error.number,
            name=pair.source_name if error.role == "source" else pair.target_name,
            fault=error.fault,
        ) from error


def _contradicts_names(result: zo.MatchResult, regions: Sequence[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether a map takes most of the area of the target's regions, each pair (source, target), out of the source's."""
    vertex, areas = result.surface_map.vertex, result.target.vertex_areas
    outside = [areas[ours[~np.isin(vertex[ours], theirs)]].sum() for theirs, ours in regions]
    return bool(sum(outside) > CONTRADICTION * sum(areas[ours].sum() for _, ours in regions))


def _whole_target(context: Context, pair: ObjectPair) -> zo.Surface | None:
    """The target with the other half that its Mirror modifier adds; None if it has no such modifier."""
    depsgraph = context.evaluated_depsgraph_get()
    return mesh_data.read_mirrored_surface(find_mesh(context, pair.target_name), depsgraph)


def check_options(options: Collection[str]) -> None:
    """Raise a TypeError for unknown options of `match_pair`, which a stored match would ignore."""
    known = {each.name for options_of in (zo.MatchOptions, Hints) for each in fields(options_of)}
    known.update(*(signature(function).parameters for function in (match_pair, zo.match_by_proximity)))
    if unknown := set(options).difference(known):
        raise TypeError(f"A match has no option called {', '.join(sorted(unknown))}.")


def settings_to_store(context: Context, pair: ObjectPair, options: dict[str, Any]) -> dict[str, Any]:
    """The options of `match_pair`, with a fingerprint of its landmarks, to detect changes of them."""
    weighed = options.get("use_landmarks", True) and "landmarks" not in options
    if not weighed or options.get("initial", "auto") not in OF_LANDMARKS:
        return options
    source, target = find_mesh(context, pair.source_name), find_mesh(context, pair.target_name)
    return options | {stored_match.LANDMARKS: landmarks_fingerprint(context.scene, source, target)}
