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
SHARES = "Share of the target's area by part of the source: {parts}."


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
    """Sentences about the parts that provide almost nothing, and the shares of the others; none if there are none."""
    parts = part_shares(result, names)
    if len(parts) < 2:
        return ()
    silent = sorted({names[number] for number in result.silent} - {name for name, _, arrived in parts if arrived})
    if not silent:
        return ()
    notes: list[str] = []
    arrived = sorted(((share, name) for name, _, share in parts if share), reverse=True)[:LISTED]
    if arrived:
        listed = enumeration(message("'{name}' {share:.1%}", name=name, share=share) for share, name in arrived)
        notes.append(message(SHARES, parts=listed))
    quoted = enumeration(f"'{name}'" for name in silent[:LISTED])
    return (*notes, warning("Nothing arrives from {parts}.", parts=quoted))


def without_shares(notes: Sequence[str]) -> list[str]:
    """Notes on a match without the shares of parts, which only the match's own result lists."""
    return [note for note in notes if getattr(note, "template", None) != SHARES]
