# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a source by the names of its faces, and the share of the target that each provides."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.matching.components.hulls import outer_triangles
from zoomout_core.matching.memory_cache import cached_hull
from zoomout_core.matching.result import MatchResult
from zoomout_core.matching.verdict import VERDICT
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import Message, enumeration, message, warning

# Number of parts that a sentence lists, the largest first; and the share of the outside below which none is listed.
LISTED, MIN_VISIBLE = 24, 0.001
SHARES = "Share of the target's area by part of the source: {parts}."


class PartName(NamedTuple):
    """How an artist calls a part of a source.

    Attributes:
        label: the name for the user: that of the object, followed by that of the material if the object has several.
        name: of its object; empty for none.
        material: of its material; empty for none.
    """

    label: str
    name: str = ""
    material: str = ""


class NamedParts(NamedTuple):
    """The parts of a source.

    Attributes:
        names: the names of the parts.
        number: (t,) the number of the part that each triangle belongs to.
    """

    names: list[PartName]
    number: Integers


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


def name_parts(
    source: Surface,
    objects: Sequence[str] = (),
    object_of: Integers | int = -1,
    materials: Sequence[str] = (),
    material_of: Integers | int = -1,
) -> NamedParts:
    """Divide a source into parts by its objects and materials, and by its loose parts where it has neither.

    Args:
        source: a surface with t triangles.
        objects: names of objects.
        object_of: (t,) the number of each triangle's object; -1 for none.
        materials: names of materials.
        material_of: (t,) the number of each triangle's material; -1 for none.
    """
    # The empty name is appended for -1, and number 0 after sorting.
    names, number = np.unique([*objects, ""], return_inverse=True)
    looks, look = np.unique([*materials, ""], return_inverse=True)
    count = len(source.triangles)
    name, material = np.broadcast_to(number[object_of], count), np.broadcast_to(look[material_of], count)
    loose = np.where((name == 0) & (material == 0), source.components[source.triangles[:, 0]], 0)
    shape = len(names), len(looks), int(loose.max()) + 1
    keys, part = np.unique(np.ravel_multi_index((name, material, loose), shape), return_inverse=True)
    found = np.stack(np.unravel_index(keys, shape), axis=1).tolist()
    divided = np.bincount([first for first, _, _ in found]) > 1
    return NamedParts([_part_name(str(names[i]), str(looks[j]), k, bool(divided[i])) for i, j, k in found], part)


def _part_name(name: str, material: str, loose: int, divided: bool) -> PartName:
    label = ": ".join(filter(None, (name, material if divided or not name else "")))
    return PartName(label or f"part {loose}", name, material)


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
    shares = [share for share in part_shares(result, parts) if max(share.visible, share.arrived) >= MIN_VISIBLE]
    if len(shares) < 2:
        return ()
    listed = sorted(((arrived, part.label) for part, _, arrived in shares if arrived >= MIN_VISIBLE), reverse=True)
    quoted = enumeration(message("'{name}' {share:.1%}", name=name, share=share) for share, name in listed[:LISTED])
    notes = [message(SHARES, parts=quoted)]
    silent = [
        part.label
        for part, visible, arrived in shares
        if visible >= MIN_VISIBLE and arrived < VERDICT.arrived * visible
    ]
    if silent:
        notes.append(warning("Almost nothing arrives from {parts}.", parts=_quote(silent)))
    partly = _names_of_uncertain(result, parts) - set(silent)
    if partly:
        notes.append(warning("Little arrives for certain from loose parts of {parts}.", parts=_quote(sorted(partly))))
    return tuple(notes)


def _names_of_uncertain(result: MatchResult, parts: NamedParts) -> set[str]:
    """The name on most triangles of each component from which little arrives for certain."""
    component = result.source.components[result.source.triangles[:, 0]]
    return {parts.names[int(np.bincount(parts.number[component == each]).argmax())].label for each in result.uncertain}


def _quote(names: Iterable[str]) -> Message:
    return enumeration([f"'{name}'" for name in names][:LISTED])


def without_shares(notes: Sequence[str]) -> list[str]:
    """Notes on a match without the shares of parts, which only the match's own result lists."""
    return [note for note in notes if getattr(note, "template", None) != SHARES]
