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
from ..mesh_data.arrays import read_array
from ..scene.pair import evaluated_sources

# The name of a part with the share of the source's outside that it makes up, and that of the target that receives from
# it, in [0, 1].
PartShare: TypeAlias = tuple[str, float, float]
# Number of parts that a sentence lists, the largest first; and the share of the outside below which none is listed.
LISTED, MIN_VISIBLE = 8, 0.001
SHARES = "Share of the target's area by part of the source: {parts}."


def name_components(context: Context, pair: ObjectPair) -> list[str]:
    """The name of each connected component of a pair's joined source.

    It is the object's name, and, where components of the object have several materials, that of the material on most of
    the component's area.
    """
    component = pair.source.components
    with evaluated_sources(context, pair) as sources:
        labels, label, vertex, area = _labelled_faces(sources)
    shares = np.zeros((component.max() + 1, len(labels)))
    # A component without area has a name, too.
    np.add.at(shares, (component[vertex], label), area + np.finfo(float).tiny)
    return [labels[largest] for largest in shares.argmax(axis=1)]


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


def _labelled_faces(sources: Sequence[EvaluatedObject]) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """The labels of all parts, and the number of the label, a vertex and the area of each face of joined sources."""
    labels: list[str] = []
    faces, before = [], 0
    for source in sources:
        mesh, obj = source.mesh, source.original
        names = [slot.material.name if slot.material else "" for slot in obj.material_slots]
        material = read_array(mesh.polygons, "material_index", np.int32)
        if len({name for name in names if name}) < 2:
            names, material = [""], np.zeros_like(material)
        corner = read_array(mesh.polygons, "loop_start", np.int32)
        vertex = read_array(mesh.loops, "vertex_index", np.int32)[corner]
        label = len(labels) + np.clip(material, 0, len(names) - 1)
        faces.append((label, before + vertex, read_array(mesh.polygons, "area", np.float32)))
        labels += [f"{obj.name}: {name}" if name else obj.name for name in names]
        before += len(mesh.vertices)
    label, vertex, area = map(np.concatenate, zip(*faces, strict=True))
    return labels, label, vertex, area
