# SPDX-License-Identifier: GPL-3.0-or-later
"""The match of each object of a collection, cut out of that of all objects as one surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.matching.report.verdict import LOW_CONFIDENCE
from zoomout_core.mesh.triangles import vertex_areas
from zoomout_core.messages import Message, message, plural

from ...mesh_data import Fingerprint, ObjectPair
from ...storage.stored_match import StoredMatch

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
        first_triangle: (p + 1,) the same for triangles.
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


def match_of_target(
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
        yield plural(
            elsewhere,
            "1 vertex corresponds to an object other than {sources}: mapped to the nearest point there, with zero "
            "confidence.",
            "{count:,} vertices correspond to objects other than {sources}: mapped to the nearest "
            "point there, with zero confidence.",
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
