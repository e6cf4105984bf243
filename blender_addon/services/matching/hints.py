# SPDX-License-Identifier: GPL-3.0-or-later
"""Hints of a match from two objects: landmarks, shared names, the up axis, the last match.

Hints are soft constraints, which `zoomout_core` weighs: if they contradict the shapes, the shapes may win.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.messages import enumeration, message, plural, sentences
from zoomout_core.runtime.progress import stage

from ... import mesh_data
from ...jobs import pause
from ...mesh_data import ObjectPair
from ...scene.landmarks import NO_LANDMARKS, OF_LANDMARKS, LandmarkPairs, landmark_pairs, landmarks_in_words
from ...scene.pair import find_mesh, source_mesh, target_mesh
from ...storage import stored_match
from ...storage.stored_report import transfer_report

# Minimum weight of a member of a vertex group.
MEMBER = 0.5
# Maximum number of regions; the largest are used, since smaller ones inside or beside them add little.
MAX_REGIONS = 36
GROUP, MATERIAL = "vertex group", "material"
# Singular and plural of hints that help a match.
HINTS = {
    GROUP: ("{count} vertex group of the same name", "{count} vertex groups of the same name"),
    MATERIAL: ("{count} material of the same name", "{count} materials of the same name"),
}

# Vertices of each region of an object, by its kind, GROUP or MATERIAL, and its name.
NamedRegions = dict[tuple[str, str], np.ndarray]


@dataclass(frozen=True)
class Hints:
    """Which hints a match uses, beside the shapes.

    Attributes:
        names: whether vertex groups, and materials, of the same name correspond. Those that the target has from an
            earlier transfer are not used: they would only prove the match that they came from.
        same_up: whether both objects are upright in the world.
        from_last: whether to start from the match stored on the target.
        use_landmarks: whether an automatic start uses the landmarks that both objects have.
        exact_landmarks: whether the match has to meet these, or the landmarks in the options.
    """

    names: bool = True
    same_up: bool = False
    from_last: bool = False
    use_landmarks: bool = True
    exact_landmarks: bool = False


def landmarks_of_pair(context: Context, pair: ObjectPair, initial: str, wanted: bool) -> LandmarkPairs:
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


async def arguments_of_hints(
    context: Context, pair: ObjectPair, hints: Hints, landmarks: int
) -> tuple[dict[str, Any], list[str]]:
    """Arguments of `zoomout_core.match`, and notes about them and the number of landmarks."""
    arguments: dict[str, Any] = {}
    used, notes = [], []
    if landmarks:
        used.append(landmarks_in_words(landmarks))
    if hints.names:
        regions, received = await shared_regions(context, pair)
        if regions:
            arguments["regions"] = list(regions.values())
            used += _count_in_words(regions)
        if received:
            notes.append("Names that the target received by an earlier transfer were not used as hints.")
    if hints.same_up:
        arguments["common_axes"] = (0, 0, 1)  # the surfaces are in world space
        used.append(message("the same up axis"))
    if hints.from_last:
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
