# SPDX-License-Identifier: GPL-3.0-or-later
"""Match characters of several objects, such as body, eyes and clothes, to their partners in another collection.

All objects of a collection are matched as one surface, whose parts the core pairs. Then each target stores the match
with the one or several sources that it maps to, as if these had been matched alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from bpy.types import Collection, Context, Depsgraph, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.matching.report.verdict import check_verdict
from zoomout_core.mesh.triangles import vertex_areas
from zoomout_core.messages import Message, message
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.runtime.threads import for_each

from ... import mesh_data
from ...jobs import compute, pause, run
from ...mesh_data import Fingerprint, ObjectPair
from ...scene.pair import (
    READING,
    check_distinct,
    check_not_edited,
    find_mesh,
    fingerprint_source,
    fingerprint_target,
)
from ...storage.stored_match import LOW_CONFIDENCE, StoredMatch
from ..targets import Write
from .candidates import store_match
from .name_matching import pair_by_name

# Fraction of the progress that matching takes.
MATCHING = 0.95
# If a source has at least this fraction of a target's area, weighted by confidence, it is the only source; loose parts
# that map to other sources still receive data from those.
NEARLY_ALL = 0.95
# Otherwise, every source with at least this fraction of the area is a source of the target.
SMALLEST_SHARE = 0.005
# Vertices that map to the partner of another target are projected onto the partner of their own, up to this
# distance over the square root of the sources' area.
NEAR = 0.02
# Weight of a vertex with a confidence of 0.
MIN_CONFIDENCE = 1e-6

# Numbers of sources and targets with matching names.
Pairs: TypeAlias = Sequence[tuple[int, int]]


@dataclass(frozen=True, eq=False)
class Parts:
    """The objects of a collection as one surface.

    Attributes:
        fingerprints: fingerprints of the objects, taken when they were read.
        surfaces: surface of each object.
        joined: all surfaces as one.
        first_vertex: (p + 1,) the first vertex of each in the joined surface, then the number of vertices.
        first_triangle: (p + 1,) likewise for triangles.
    """

    fingerprints: tuple[Fingerprint, ...]
    surfaces: tuple[zo.Surface, ...]
    joined: zo.Surface
    first_vertex: Integers
    first_triangle: Integers

    @classmethod
    def of(cls, fingerprints: Sequence[Fingerprint], surfaces: Sequence[zo.Surface]) -> Parts:
        """Join the objects with these fingerprints and surfaces."""
        vertices = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
        triangles = np.cumsum([0, *(len(surface.triangles) for surface in surfaces)])
        return cls(tuple(fingerprints), tuple(surfaces), zo.Surface.joined(surfaces), vertices, triangles)

    @property
    def names(self) -> list[str]:
        """Names of the objects."""
        return [fingerprint.name for fingerprint in self.fingerprints]


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
    return run(match_collections_async(context, source.name, target.name, **options))


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
        RefusedMatchError: one is probably wrong, and may not be used all the same.
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
            lambda i: _match_of_target(result, sources, targets, i, namesakes), range(len(targets.fingerprints))
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
    """Read the objects of a collection whose meshes have faces; of those that share a mesh, the first."""
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


@dataclass(frozen=True, eq=False)
class _TargetMap:
    """The map of one of the targets to the joined source.

    Attributes:
        surface_map: the target's vertices on the joined source.
        confidence: (n,) confidence of each vertex.
        owner: (n,) the number of the source that each vertex maps to.
        part: (n,) the loose part of each vertex, -1 for none.
        weight: (n,) fraction of the area of each vertex.
    """

    surface_map: zo.SurfaceMap
    confidence: Floats
    owner: Integers
    part: Integers
    weight: Floats

    def contributors(self, sources: int) -> list[int]:
        """Numbers of the target's sources, by decreasing share of its area."""
        share = np.bincount(self.owner, self.weight * (self.confidence + MIN_CONFIDENCE), minlength=sources)
        share /= share.sum()
        largest = int(np.argmax(share))
        wanted = {largest, *self._sources_of_loose_parts(sources)}
        if share[largest] < NEARLY_ALL:
            wanted |= set(np.flatnonzero(share >= SMALLEST_SHARE).tolist())
        return sorted(wanted, key=lambda number: -share[number])

    def _sources_of_loose_parts(self, sources: int) -> list[int]:
        """Numbers of the sources that loose parts mostly map to, if their mean confidence exceeds `LOW_CONFIDENCE`."""
        used = self.part >= 0
        place = self.part[used] * sources + self.owner[used]
        count = (self.part.max() + 1) * sources
        area, confident_area = (
            np.bincount(place, weight[used], minlength=count).reshape(-1, sources)
            for weight in (self.weight, self.weight * self.confidence)
        )
        confident = confident_area.sum(axis=1) > LOW_CONFIDENCE * area.sum(axis=1)
        return np.unique(np.argmax(confident_area[confident], axis=1)).tolist()


def _match_of_target(
    result: zo.MatchResult | KnownMatch, sources: Parts, targets: Parts, number: int, namesakes: Pairs
) -> tuple[ObjectPair, StoredMatch]:
    """One of the targets with the sources that it maps to, and the match with these."""
    own = _move_to_namesake(_target_map(result, sources, targets, number), sources, number, namesakes)
    contributors = own.contributors(len(sources.names))
    pair = ObjectPair(
        tuple(sources.surfaces[i] for i in contributors),
        targets.surfaces[number],
        tuple(sources.fingerprints[i] for i in contributors),
        targets.fingerprints[number],
    )
    surface_map, elsewhere = _onto_contributors(own, contributors, sources, pair)
    confidence = own.confidence.copy()
    confidence[elsewhere] = 0
    has_partner = result.has_partner[slice(*targets.first_vertex[number : number + 2])]
    of_sources = np.concatenate(
        [result.source_has_partner[slice(*sources.first_vertex[i : i + 2])] for i in contributors]
    )
    return pair, StoredMatch(
        surface_map,
        confidence,
        (*result.notes, *_notes_on_sources(pair, len(elsewhere))),
        others=pair.source_names[1:],
        has_partner=has_partner,
        source_has_partner=of_sources,
        without_partner=(pair.target.share_of_area(~has_partner), pair.source.share_of_area(~of_sources)),
        verdict=result.verdict if isinstance(result, zo.MatchResult) else None,
    )


def _onto_contributors(
    own: _TargetMap, contributors: Sequence[int], sources: Parts, pair: ObjectPair
) -> tuple[zo.SurfaceMap, Integers]:
    """The map of a target onto the sources of a pair, which are some of all sources, by number.

    Returns:
        The map, and the numbers of vertices that map to other sources: they take the nearest point of the pair's.
    """
    counts = [len(sources.surfaces[i].triangles) for i in contributors]
    offset = np.full(len(sources.names), -1)  # of each source's triangles in the pair, -1 for others
    offset[contributors] = np.cumsum([0, *counts[:-1]])
    triangle = own.surface_map.triangle - sources.first_triangle[own.owner] + offset[own.owner]
    barycentric = own.surface_map.barycentric.copy()
    elsewhere = np.flatnonzero(offset[own.owner] < 0)
    if len(elsewhere):
        images = own.surface_map.interpolate(sources.joined.vertices)[elsewhere]
        triangle[elsewhere], barycentric[elsewhere] = closest_points(
            images, pair.source.vertices, pair.source.triangles
        )
    return zo.SurfaceMap(triangle, barycentric, pair.source.triangles), elsewhere


def _notes_on_sources(pair: ObjectPair, elsewhere: int) -> Iterator[Message]:
    """Sentences about several sources, and about a number of vertices that map to others."""
    names = ", ".join(f"'{name}'" for name in pair.source_names)
    if len(pair.source_names) > 1:
        yield message(
            "'{target}' corresponds to several objects and receives data from all of them: {sources}.",
            target=pair.target_name,
            sources=names,
        )
    if elsewhere:
        yield message(
            "{count:,} vertices correspond to objects other than {sources}: mapped to the nearest "
            "point there, with zero confidence.",
            count=elsewhere,
            sources=names,
        )


def _target_map(result: zo.MatchResult | KnownMatch, sources: Parts, targets: Parts, number: int) -> _TargetMap:
    """The map of one of the targets to the joined source."""
    own = slice(*targets.first_vertex[number : number + 2])
    whole, surface = result.surface_map, targets.surfaces[number]
    return _TargetMap(
        zo.SurfaceMap(whole.triangle[own], whole.barycentric[own], whole.source_triangles),
        result.confidence[own],
        np.searchsorted(sources.first_triangle, whole.triangle[own], side="right") - 1,
        targets.joined.components[own],
        vertex_areas(surface.vertices, surface.triangles) / surface.area,
    )


def _move_to_namesake(own: _TargetMap, sources: Parts, number: int, namesakes: Pairs) -> _TargetMap:
    """Project a target's map onto the source whose name matches the target's, where that is within `NEAR`.

    Only vertices that map to the partner of another target are moved, such as those of boots that map to trousers.
    """
    namesake = next((j for j, i in namesakes if i == number), None)
    misplaced = np.flatnonzero(np.isin(own.owner, [j for j, i in namesakes if i != number]))
    if namesake is None or not len(misplaced):
        return own
    surface, mapped = sources.surfaces[namesake], own.surface_map
    images = mapped.interpolate(sources.joined.vertices)[misplaced]
    found, weights = closest_points(images, surface.vertices, surface.triangles)
    apart = zo.SurfaceMap(found, weights, surface.triangles).interpolate(surface.vertices) - images
    near = np.linalg.norm(apart, axis=1) < NEAR * np.sqrt(sources.joined.area)
    triangle, barycentric, owner = mapped.triangle.copy(), mapped.barycentric.copy(), own.owner.copy()
    moved = misplaced[near]
    triangle[moved], barycentric[moved] = found[near] + sources.first_triangle[namesake], weights[near]
    owner[moved] = namesake
    return replace(own, surface_map=zo.SurfaceMap(triangle, barycentric, mapped.source_triangles), owner=owner)
