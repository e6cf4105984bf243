# SPDX-License-Identifier: GPL-3.0-or-later
"""Constraints on a match besides the shapes: landmarks, shared names, the up axis, the last match.

All are soft constraints, which `zoomout_core` weighs: if they contradict the shapes, the shapes may win.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from dataclasses import fields, replace
from functools import partial
from inspect import signature
from typing import Any

import numpy as np
from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.matching.pair import LandmarkError
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.matching.report.part_report import name_components, notes_on_parts
from zoomout_core.messages import enumeration, message, plural, sentences
from zoomout_core.runtime.progress import stage

from .. import mesh_data
from ..jobs import compute, pause
from ..mesh_data import ObjectPair
from ..scene.landmarks import (
    NO_LANDMARKS,
    OF_LANDMARKS,
    LandmarkPairs,
    landmark_pairs,
    landmarks_fingerprint,
    landmarks_in_words,
)
from ..scene.pair import find_mesh, source_mesh, target_mesh
from ..storage import stored_match
from ..storage.stored_match import Match
from ..storage.stored_report import transfer_report
from .matching.bone_match import correct_match
from .matching.half_match import HalfResult
from .matching.initial_maps import map_of_file, same_order
from .matching.parts import read_parts

# Minimum weight of a member of a vertex group.
MEMBER = 0.5
# Maximum number of regions; the largest are used, since smaller ones inside or beside them add little.
MAX_REGIONS = 36
# From this part of the area of named regions on that the map takes elsewhere, a note warns the user.
CONTRADICTION = 0.6
GROUP, MATERIAL = "vertex group", "material"
# Singular and plural of hints that help a match.
HINTS = {
    GROUP: ("{count} vertex group of the same name", "{count} vertex groups of the same name"),
    MATERIAL: ("{count} material of the same name", "{count} materials of the same name"),
}
# Options that refer to the target's vertices by number.
OF_VERTICES = frozenset({"regions", "initial_map"})

# Vertices of each region of an object, by its kind, GROUP or MATERIAL, and its name.
NamedRegions = dict[tuple[str, str], np.ndarray]


async def match_pair(
    context: Context,
    pair: ObjectPair,
    names: bool = True,
    same_up: bool = False,
    from_last: bool = False,
    use_landmarks: bool = True,
    exact_landmarks: bool = False,
    map_file: str = "",
    detail: str = "balanced",
    k_final: int = 0,
    **options: Any,
) -> Match:
    """`zoomout_core.match` with the constraints from two objects, which the result's notes list.

    With initial="nearest" it is `zoomout_core.match_by_proximity`, and with "same_order" each vertex maps to the one of
    the same number; neither uses constraints. With "landmarks" only the landmarks are constraints, and with "file"
    there are none: the match starts from `map_file`.

    Args:
        context: Blender's; both objects are in its scene.
        pair: the two, as they are now.
        names: whether vertex groups, and materials, of the same name correspond. Those that the target has from an
            earlier transfer are not used: they would only prove the match that they came from.
        same_up: whether both objects are upright in the world.
        from_last: whether to start from the match stored on the target.
        use_landmarks: whether an automatic start uses the landmarks that both objects have.
        exact_landmarks: whether the match has to meet these, or the landmarks in the options.
        map_file: a map that `zoomout match` wrote.
        detail: one of `DETAIL`.
        k_final: size of the final functional map; 0 for that of `detail`.
        options: options of `zoomout_core.match`, of which only an automatic start uses constraints; or of
            `zoomout_core.match_by_proximity`.

    Raises:
        MeshError: see `zoomout_core.match`; or there are no landmarks to start from, or the map file does not exist.
    """
    initial = options.pop("initial", "auto")
    if initial == "nearest":
        return await compute(partial(zo.match_by_proximity, pair.source, pair.target, **options))
    if initial == "same_order":
        with stage("Comparing the order"):
            return await compute(partial(same_order, pair))
    arguments = resolve_detail(detail, k_final, initial=initial)
    if initial == "file":
        arguments |= {"initial": "given", "initial_map": map_of_file(pair, map_file)}
    landmarks = _landmarks(context, pair, initial, use_landmarks and "landmarks" not in options)
    notes = list(landmarks.notes)
    if landmarks.numbers:
        arguments["landmarks"] = landmarks.source, landmarks.target
    if exact_landmarks and "landmarks" in arguments | options:
        arguments["exact_landmarks"] = True
    whole = _whole_target(context, pair) if initial in OF_LANDMARKS and not OF_VERTICES & options.keys() else None
    if initial == "auto":
        constraints, of_constraints = await _constraints(
            context, pair, names and whole is None, same_up, from_last and whole is None, len(landmarks.numbers)
        )
        arguments |= constraints
        notes = of_constraints + notes
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
    functions = match_pair, zo.match_by_proximity
    known = {field.name for field in fields(zo.MatchOptions)}.union(*(signature(each).parameters for each in functions))
    if unknown := set(options).difference(known):
        raise TypeError(f"A match has no option called {', '.join(sorted(unknown))}.")


def settings_to_store(context: Context, pair: ObjectPair, options: dict[str, Any]) -> dict[str, Any]:
    """The options of `match_pair`, with a fingerprint of its landmarks, to detect changes of them."""
    weighed = options.get("use_landmarks", True) and "landmarks" not in options
    if not weighed or options.get("initial", "auto") not in OF_LANDMARKS:
        return options
    source, target = find_mesh(context, pair.source_name), find_mesh(context, pair.target_name)
    return options | {stored_match.LANDMARKS: landmarks_fingerprint(context.scene, source, target)}


def _landmarks(context: Context, pair: ObjectPair, initial: str, wanted: bool) -> LandmarkPairs:
    """The landmarks to match by.

    Raises:
        MeshError: the match is to start from landmarks, and there are none.
    """
    if not wanted or initial not in OF_LANDMARKS:
        return NO_LANDMARKS
    found = landmark_pairs(context, find_mesh(context, pair.source_name), find_mesh(context, pair.target_name))
    if initial == "landmarks" and not found.numbers:
        reasons = sentences("", *found.notes)
        raise zo.MeshError(
            "Matching from landmarks needs at least one landmark on both '{source}' and '{target}': "
            "place some, or choose another method.{reasons}",
            source=pair.source_name,
            target=pair.target_name,
            reasons=reasons,
        )
    return found


async def _constraints(
    context: Context, pair: ObjectPair, names: bool, same_up: bool, from_last: bool, landmarks: int
) -> tuple[dict[str, Any], list[str]]:
    """Arguments of `zoomout_core.match`, and notes about them and the number of landmarks."""
    arguments: dict[str, Any] = {}
    used, notes = [], []
    if landmarks:
        used.append(landmarks_in_words(landmarks))
    if names:
        regions, received = await shared_regions(context, pair)
        if regions:
            arguments["regions"] = list(regions.values())
            used += _count_in_words(regions)
        if received:
            notes.append("Names that the target received by an earlier transfer were not used as hints.")
    if same_up:
        arguments["common_axes"] = (0, 0, 1)  # the surfaces are in world space
        used.append(message("the same up axis"))
    if from_last:
        with target_mesh(context, pair) as (_, mesh):
            last = _last_match(mesh, pair)
        if last is None:
            notes.append("There is no current match of these two meshes to start from: turn off Last Match.")
        else:
            arguments["initial_map"] = last
            used.append(message("the last match"))
    if used:
        notes.insert(0, message("Hints used: {hints}.", hints=enumeration(used)))
    return arguments, notes


async def shared_regions(
    context: Context, pair: ObjectPair
) -> tuple[dict[tuple[str, str], tuple[np.ndarray, np.ndarray]], bool]:
    """The regions of the same name on both objects that cover a part of either, the largest first.

    Returns:
        The source's and the target's vertices of each, by its kind and name; and whether others were left out because
        the target has them from an earlier transfer.
    """
    with target_mesh(context, pair) as (target, _):
        if not target.vertex_groups and not target.material_slots:
            return {}, False  # reading weights takes long
        written = (transfer_report(target) or {"written": {}})["written"]
    received = {GROUP: written.get("vertex_groups", ()), MATERIAL: written.get("materials", ())}
    with stage("Reading names", 0, 0):
        of_source = await _regions(partial(source_mesh, context, pair), pair.source)
        of_target = await _regions(partial(target_mesh, context, pair), pair.target)
    shared = {region: (of_source[region], of_target[region]) for region in of_source if region in of_target}
    own = [(what, name) for what, name in shared if name not in received[what]]
    size = {region: _smaller_share(shared[region], pair) for region in own}
    largest = sorted(own, key=lambda region: -size[region])[:MAX_REGIONS]
    return {region: shared[region] for region in largest}, len(own) < len(shared)


async def _regions(
    fetch: Callable[[], AbstractContextManager[tuple[Object, Mesh]]], surface: zo.Surface
) -> NamedRegions:
    """The regions that an object's vertex groups and materials cover, if only a part of it."""
    regions: NamedRegions = {}
    weights = await mesh_data.read_weights_in_pieces(fetch)
    members = (weights.values >= MEMBER).tocsc()
    for column, name in enumerate(weights.labels):
        regions[GROUP, name] = members.indices[slice(*members.indptr[column : column + 2])]
    with fetch() as (obj, mesh):
        names, face_slots = mesh_data.read_materials(obj, mesh)
    corner_slot = np.repeat(face_slots.values, np.diff(surface.face_start))
    for name in filter(None, dict.fromkeys(names)):
        await pause()
        slots = [slot for slot, other in enumerate(names) if other == name]
        regions[MATERIAL, name] = np.unique(surface.corner_vertex[np.isin(corner_slot, slots)])
    return {region: found for region, found in regions.items() if 0 < len(found) < len(surface.vertices)}


def _smaller_share(region: tuple[np.ndarray, np.ndarray], pair: ObjectPair) -> float:
    return min(len(found) / len(of.vertices) for found, of in zip(region, (pair.source, pair.target), strict=True))


def _last_match(mesh: Mesh, pair: ObjectPair) -> zo.SurfaceMap | None:
    """The map of the match stored on the target's mesh, if it is valid for this pair."""
    try:
        stored = stored_match.read(mesh, pair)
    except zo.MeshError:  # one of them was edited since
        return None
    return None if stored is None else stored.surface_map


def _count_in_words(regions: Collection[tuple[str, str]]) -> list[str]:
    """The number of regions of each kind, in words."""
    numbers = Counter(what for what, _ in regions)
    return [plural(numbers[what], *HINTS[what]) for what in HINTS if numbers[what]]
