# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a source by the names of its faces, and the share of the target that each provides."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.matching.components.hulls import outer_triangles
from zoomout_core.matching.memory_cache import cached_hull
from zoomout_core.matching.result import MatchResult
from zoomout_core.matching.verdict import VERDICT
from zoomout_core.messages import Message, enumeration, message, warning

# The name of a part with the share of the source's outside that it makes up, and that of the target that receives from
# it, in [0, 1].
PartShare: TypeAlias = tuple[str, float, float]
# Number of parts that a sentence lists, the largest first; and the share of the outside below which none is listed.
LISTED, MIN_VISIBLE = 24, 0.001
SHARES = "Share of the target's area by part of the source: {parts}."


def part_shares(result: MatchResult, names: Sequence[str], number: Integers) -> list[PartShare]:
    """The shares of parts by their names, those of the largest visible share first; parts of one name together.

    Args:
        result: a match.
        names: the names of parts.
        number: (f,) the number of the part that each face of the source belongs to.
    """
    if len(result.pair.shares) < 2:  # the source was matched as a single part
        return []
    part = number[result.source.triangle_face]
    outer, areas = outer_triangles(result.source, cached_hull(result.source)), result.target.vertex_areas
    visible = np.bincount(part[outer], minlength=len(names)) / len(outer)
    arrived = np.bincount(part[result.surface_map.triangle], areas, len(names)) / areas.sum()
    shares: dict[str, tuple[float, float]] = {}
    for name, of_source, of_target in zip(names, visible.tolist(), arrived.tolist(), strict=True):
        before = shares.get(name, (0.0, 0.0))
        shares[name] = before[0] + of_source, before[1] + of_target
    parts = [(name, *both) for name, both in shares.items() if max(both) >= MIN_VISIBLE]
    return sorted(parts, key=lambda part: -part[1])


def notes_on_parts(result: MatchResult, names: Sequence[str], number: Integers) -> tuple[str, ...]:
    """Sentences about the share of each part, and those that provide almost nothing; arguments as for `part_shares`."""
    parts = part_shares(result, names, number)
    if len(parts) < 2:
        return ()
    listed = sorted(((share, name) for name, _, share in parts if share >= MIN_VISIBLE), reverse=True)[:LISTED]
    notes = [
        message(
            SHARES, parts=enumeration(message("'{name}' {share:.1%}", name=name, share=share) for share, name in listed)
        )
    ]
    silent = [
        name for name, visible, arrived in parts if visible >= MIN_VISIBLE and arrived < VERDICT.arrived * visible
    ]
    if silent:
        notes.append(warning("Almost nothing arrives from {parts}.", parts=_quote(silent)))
    partly = _names_of_uncertain(result, names, number) - set(silent)
    if partly:
        notes.append(warning("Little arrives for certain from loose parts of {parts}.", parts=_quote(sorted(partly))))
    return tuple(notes)


def _names_of_uncertain(result: MatchResult, names: Sequence[str], number: Integers) -> set[str]:
    """The name on most of the faces of each component from which little arrives for certain."""
    source = result.source
    component = source.components[source.corner_vertex[source.face_start[:-1]]]
    return {names[int(np.bincount(number[component == each]).argmax())] for each in result.uncertain}


def _quote(names: Iterable[str]) -> Message:
    return enumeration([f"'{name}'" for name in names][:LISTED])


def without_shares(notes: Sequence[str]) -> list[str]:
    """Notes on a match without the shares of parts, which only the match's own result lists."""
    return [note for note in notes if getattr(note, "template", None) != SHARES]
