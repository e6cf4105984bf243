# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a source by the names of its faces, and the share of the target that each provides."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.matching.components.hulls import outer_triangles
from zoomout_core.matching.preparation.memory_cache import cached_hull
from zoomout_core.matching.report.verdict import VERDICT
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.named_parts import NamedParts, PartName
from zoomout_core.messages import Message, enumeration, message, warning

# Number of parts that a sentence lists, the largest first.
LISTED = 24
SHARES = "Share of the target's area by part of the source: {parts}."


class PartShare(NamedTuple):
    """How much of a source and of a target belongs to a part.

    Attributes:
        part: the part.
        visible: the share of the source's outside that it makes up, in [0, 1].
        arrived: the share of the target's area that receives from it, in [0, 1].
    """

    part: PartName
    visible: float
    arrived: float


def part_shares(result: MatchResult, parts: NamedParts) -> list[PartShare]:
    """The share of each part, the largest visible share first; none if the source was matched as a single part."""
    if len(result.pair.shares) < 2:
        return []
    count = len(parts.names)
    outer, areas = outer_triangles(result.source, cached_hull(result.source)), result.target.vertex_areas
    visible = np.bincount(parts.number[outer], minlength=count) / len(outer)
    arrived = np.bincount(parts.number[result.surface_map.triangle], areas, count) / areas.sum()
    shares = map(PartShare, parts.names, visible.tolist(), arrived.tolist())
    return sorted(shares, key=lambda share: -share.visible)


def part_figures(result: MatchResult, parts: NamedParts) -> list[dict[str, Any]]:
    """The shares of parts for programs."""
    return [
        {
            "part": part.label,
            "name": part.name or None,
            "material": part.material or None,
            "visible": visible,
            "arrived": arrived,
        }
        for part, visible, arrived in part_shares(result, parts)
    ]


def notes_on_parts(result: MatchResult, parts: NamedParts) -> tuple[str, ...]:
    """Sentences about the share of each part, and those that provide almost nothing."""
    shares = [share for share in part_shares(result, parts) if max(share.visible, share.arrived) >= VERDICT.visible]
    if len(shares) < 2:
        return ()
    listed = sorted(((arrived, part.label) for part, _, arrived in shares if arrived >= VERDICT.visible), reverse=True)
    quoted = enumeration(message("'{name}' {share:.1%}", name=name, share=share) for share, name in listed[:LISTED])
    notes = [message(SHARES, parts=quoted)]
    silent = [
        part.label
        for part, visible, arrived in shares
        if visible >= VERDICT.visible and arrived < VERDICT.arrived * visible
    ]
    if silent:
        notes.append(warning("Almost nothing arrives from {parts}.", parts=_quote(silent)))
    partly = _names_of_uncertain(result, parts) - set(silent)
    if partly:
        notes.append(
            warning(
                "The target receives little reliable data from loose parts of {parts}.", parts=_quote(sorted(partly))
            )
        )
    return tuple(notes)


def name_components(result: MatchResult, parts: NamedParts) -> MatchResult:
    """The result with the name on most triangles of each component, which its verdict depends on."""
    return replace(result, names=_names_of_components(result, parts))


def _names_of_components(result: MatchResult, parts: NamedParts) -> Integers:
    """(c,) the number of the name on most triangles of each component of the source."""
    component = result.source.components[result.source.triangles[:, 0]]
    count = np.zeros((len(result.pair.shares), len(parts.names)), dtype=np.int64)
    np.add.at(count, (component, parts.number), 1)
    return np.asarray(count.argmax(axis=1))


def _names_of_uncertain(result: MatchResult, parts: NamedParts) -> set[str]:
    """The names of the components from which the target receives little reliable data."""
    return {parts.names[number].label for number in _names_of_components(result, parts)[result.uncertain]}


def _quote(names: Iterable[str]) -> Message:
    return enumeration([f"'{name}'" for name in names][:LISTED])


def without_shares(notes: Sequence[str]) -> list[str]:
    """Notes on a match without the shares of parts, which only the match's own result lists."""
    return [note for note in notes if getattr(note, "template", None) != SHARES]
