# SPDX-License-Identifier: GPL-3.0-or-later
"""The names that an artist gave the parts of a source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.mesh.named_parts import NamedParts, name_parts

from ...mesh_data import EvaluatedObject, ObjectPair
from ...mesh_data.arrays import read_array
from ...scene.pair import evaluated_sources


def read_parts(context: Context, pair: ObjectPair) -> NamedParts:
    """Read the parts of a pair's sources."""
    with evaluated_sources(context, pair) as sources:
        return _parts_of(sources, pair.source)


def _parts_of(sources: Sequence[EvaluatedObject], surface: zo.Surface) -> NamedParts:
    materials: list[str] = []
    numbers = []
    for source in sources:
        names = [slot.material.name if slot.material else "" for slot in source.original.material_slots] or [""]
        slot = np.zeros(len(source.mesh.polygons), dtype=np.int32)
        if len(names) > 1:
            slot = np.clip(read_array(source.mesh.polygons, "material_index", np.int32), 0, len(names) - 1)
        numbers.append(len(materials) + slot)
        materials += names
    objects = np.repeat(np.arange(len(sources)), [len(each) for each in numbers])
    face = surface.triangle_face
    return name_parts(
        surface,
        [source.original.name for source in sources],
        objects[face],
        materials,
        np.concatenate(numbers)[face],
    )
