# SPDX-License-Identifier: GPL-3.0-or-later
"""Match characters of several objects, such as body, eyes and clothes, to their partners in another collection.

All objects of a collection are matched as one surface, whose parts the core pairs. Then each target stores the match
with the one or several sources that it maps to, as if these had been matched alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Collection, Context, Depsgraph, Object

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.matching.report.verdict import check_verdict
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.runtime.threads import for_each

from ... import mesh_data
from ...jobs import compute, pause, run
from ...mesh_data import Fingerprint, ObjectPair
from ...scene.pair import (
    READING,
    check_context,
    check_distinct,
    check_not_edited,
    find_mesh,
    fingerprint_source,
    fingerprint_target,
    name_of,
)
from ...storage.stored_match import StoredMatch
from ..targets import Write
from .candidates import store_match
from .joined_match import Pairs, Parts, match_of_target
from .name_matching import pair_by_name

# Fraction of the progress that matching takes.
MATCHING = 0.95


def match_collections(
    context: Context, source: Collection, target: Collection, **options: Any
) -> dict[str, tuple[str, StoredMatch]]:
    """Match the meshes of two collections, and store the match with its partner on each target.

    Args:
        context: Blender's; the objects are in its scene.
        source: the collection with the data; its meshes are read after their modifiers.
        target: the collection that receives the data.
        options: `detail`, one of `DETAIL`, and options of `zoomout_core.match`.

    Returns:
        By the name of each target, the name of its source and the match, which names further sources.

    Raises:
        MeshError: an object cannot be used; nothing was written.
    """
    check_context(context)
    return run(match_collections_async(context, name_of(source), name_of(target), **options))


async def match_collections_async(
    context: Context, source: str, target: str, **options: Any
) -> dict[str, tuple[str, StoredMatch]]:
    """`match_collections` as a coroutine, which keeps no Blender data across an `await`."""
    write = await prepare_collections(context, source, target, **options)
    return write()


async def prepare_collections(
    context: Context, source: str, target: str, detail: str = "balanced", **options: Any
) -> Write[dict[str, tuple[str, StoredMatch]]]:
    """`match_collections_async` without writing: returns a function that stores the matches."""
    sources = await _read(context, source, fingerprint_source, mesh_data.read_source_surface)
    targets = await _read(context, target, fingerprint_target, mesh_data.read_target_surface)
    if shared := set(sources.names) & set(targets.names):
        raise zo.MeshError(
            "'{name}' is in both collections: choose two collections without common meshes.", name=min(shared)
        )
    return await prepare_parts(context, sources, targets, None, detail, **options)


async def prepare_parts(
    context: Context, sources: Parts, targets: Parts, known: KnownMatch | None, detail: str = "balanced", **options: Any
) -> Write[dict[str, tuple[str, StoredMatch]]]:
    """`prepare_collections` for objects that were read already.

    Args:
        context: Blender's.
        sources: the objects with the data.
        targets: the objects that receive it.
        known: the match of the joined surfaces, or None to match them.
        detail: detail of a new match.
        options: options of a new match.
    """
    matches = await compute(partial(_matches, sources, targets, known, resolve_detail(detail, **options)))

    def write() -> dict[str, tuple[str, StoredMatch]]:
        written = [_find_target(context, pair) for pair, _ in matches]
        with mesh_data.all_or_nothing(*written):
            for obj, (pair, match) in zip(written, matches, strict=True):
                store_match(obj.data, match, pair, options | {"detail": detail})
        return {pair.target_name: (pair.source_name, match) for pair, match in matches}

    return write


def check_verdicts(matches: Mapping[str, tuple[str, StoredMatch]], force: bool) -> None:
    """Refuse matches by `prepare_parts` that are probably wrong, unless the user insists.

    Raises:
        RefusedMatchError: one is probably wrong, and `force` is not set.
    """
    for _, match in matches.values():
        if match.verdict is not None:
            check_verdict(match.verdict, force)


def _matches(
    sources: Parts, targets: Parts, known: KnownMatch | None, options: dict[str, Any]
) -> list[tuple[ObjectPair, StoredMatch]]:
    """Each target with the sources that it maps to, and the match with these."""
    namesakes = pair_by_name(sources.names, targets.names)
    result: zo.MatchResult | KnownMatch
    if known is not None:
        result = known
    else:
        arguments = {"regions": _regions(sources, targets, namesakes)} | options
        with portion(0, MATCHING):
            result = zo.match(sources.joined, targets.joined, **arguments)
    with stage("Pairing the objects", MATCHING, 1):
        return for_each(
            lambda i: match_of_target(result, sources, targets, i, namesakes), range(len(targets.fingerprints))
        )


def _find_target(context: Context, pair: ObjectPair) -> Object:
    """The target of a pair, after checking that it is writable and was not edited."""
    source, target = check_not_edited(context, pair)
    check_distinct(source, target)
    return target


async def _read(
    context: Context,
    collection: str,
    fingerprint: Callable[[Context, str], Fingerprint],
    read: Callable[[Object, Depsgraph], zo.Surface],
) -> Parts:
    """Read the objects of a collection whose meshes have faces. If several share a mesh, only the first is read."""
    found = context.blend_data.collections.get(collection)
    if found is None:
        raise zo.MeshError("There is no collection '{collection}': choose another one.", collection=collection)
    objects = {obj.data: obj for obj in reversed(found.all_objects) if obj.type == "MESH" and obj.data.polygons}
    names = [obj.name for obj in reversed(objects.values())]
    if not names:
        raise zo.MeshError(
            "There is no mesh in the collection '{collection}': choose another one.", collection=collection
        )
    del found, objects  # Blender data, which may be freed in a pause
    fingerprints, surfaces = [], []
    with stage(READING, 0, 0):
        for name in names:
            fingerprints.append(fingerprint(context, name))
            await pause()
            surfaces.append(read(find_mesh(context, name), context.evaluated_depsgraph_get()))
            await pause()
    return Parts.of(fingerprints, surfaces)


def _regions(sources: Parts, targets: Parts, namesakes: Pairs) -> list[tuple[Integers, Integers]]:
    """Vertices of the joined surfaces for each pair of objects with matching names."""
    return [
        (np.arange(*sources.first_vertex[j : j + 2]), np.arange(*targets.first_vertex[i : i + 2])) for j, i in namesakes
    ]
