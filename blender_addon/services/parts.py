# SPDX-License-Identifier: GPL-3.0-or-later
"""The loose parts of a source by the artist's names, and the share of the target that each provides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.messages import enumeration, message, warning

from ..mesh_data import EvaluatedObject, ObjectPair
from ..scene.pair import evaluated_sources

# The name of a part with the share of the source's outside that it makes up, and that of the target that receives from
# it, in [0, 1].
PartShare: TypeAlias = tuple[str, float, float]
# Number of parts that a sentence lists, the largest first; and the share of the outside below which none is listed.
LISTED, MIN_VISIBLE = 8, 0.001


def name_components(context: Context, pair: ObjectPair) -> list[str]:
    """The name of each connected component of a pair's joined source.

    It is the object's name, and, where components of the object have several materials, that of the component's own.
    """
    component = pair.source.components
    with evaluated_sources(context, pair) as sources:
        names = np.concatenate([_vertex_names(source) for source in sources])
    first = np.full(component.max() + 1, -1)
    used = np.flatnonzero(component >= 0)[::-1]
    first[component[used]] = used
    return names[first].tolist()


def part_shares(result: zo.MatchResult, names: Sequence[str]) -> list[PartShare]:
    """The shares of parts by their names, those of the largest visible share first; components of one name together."""
    visible, arrived = result.pair.shares, result.arrived
    if len(visible) != len(names):  # the source was matched as a single part
        return []
    shares: dict[str, tuple[float, float]] = {}
    for name, of_source, of_target in zip(names, visible.tolist(), arrived.tolist(), strict=True):
        before = shares.get(name, (0.0, 0.0))
        shares[name] = before[0] + of_source, before[1] + of_target
    parts = [(name, *both) for name, both in shares.items() if max(both) >= MIN_VISIBLE]
    return sorted(parts, key=lambda part: -part[1])


def notes_on_parts(result: zo.MatchResult, names: Sequence[str]) -> tuple[str, ...]:
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


def _vertex_names(source: EvaluatedObject) -> np.ndarray:
    """(n,) the name of the part that each vertex of an object belongs to, as objects."""
    mesh, obj = source.mesh, source.original
    n = len(mesh.vertices)
    names = [slot.material.name if slot.material else "" for slot in obj.material_slots]
    if len({name for name in names if name}) < 2:
        return np.full(n, obj.name, dtype=object)
    material, corner = np.empty(len(mesh.polygons), np.int32), np.empty(len(mesh.loops), np.int32)
    sizes = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", material)
    mesh.polygons.foreach_get("loop_total", sizes)
    mesh.loops.foreach_get("vertex_index", corner)
    of_vertex = np.zeros(n, np.int32)
    of_vertex[corner] = np.repeat(np.clip(material, 0, len(names) - 1), sizes)
    labels = np.array([f"{obj.name}: {name}" if name else obj.name for name in names], dtype=object)
    return labels[of_vertex]
