# SPDX-License-Identifier: GPL-3.0-or-later
"""The loose parts of a source by name, and the share of the target that each provides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from zoomout_core.matching.result import MatchResult
from zoomout_core.messages import enumeration, message, warning

# The name of a part with the share of the source's outside that it makes up, and that of the target that receives from
# it, in [0, 1].
PartShare: TypeAlias = tuple[str, float, float]
# Number of parts that a sentence lists, the largest first; and the share of the outside below which none is listed.
LISTED, MIN_VISIBLE = 8, 0.001


def part_shares(result: MatchResult, names: Sequence[str]) -> list[PartShare]:
    """The shares of parts by their names, those of the largest visible share first; components of one name together.

    Args:
        result: a match.
        names: the name of each component of the source.
    """
    visible, arrived = result.pair.shares, result.arrived
    if len(visible) != len(names):  # the source was matched as a single part
        return []
    shares: dict[str, tuple[float, float]] = {}
    for name, of_source, of_target in zip(names, visible.tolist(), arrived.tolist(), strict=True):
        before = shares.get(name, (0.0, 0.0))
        shares[name] = before[0] + of_source, before[1] + of_target
    parts = [(name, *both) for name, both in shares.items() if max(both) >= MIN_VISIBLE]
    return sorted(parts, key=lambda part: -part[1])


def notes_on_parts(result: MatchResult, names: Sequence[str]) -> tuple[str, ...]:
    """Sentences about the parts that the target receives from, and about those that provide almost nothing."""
    parts = part_shares(result, names)
    if len(parts) < 2:
        return ()
    listed = [
        message("'{name}' {share:.1%}", name=name, share=arrived) for name, _, arrived in parts[:LISTED] if arrived
    ]
    silent = sorted({names[number] for number in result.silent} - {name for name, _, arrived in parts if arrived})
    notes = (
        [message("Share of the target's area by part of the source: {parts}.", parts=enumeration(listed))]
        if listed
        else []
    )
    if silent:
        quoted = enumeration(f"'{name}'" for name in silent[:LISTED])
        notes.append(warning("Nothing arrives from {parts}.", parts=quoted))
    return tuple(notes)
