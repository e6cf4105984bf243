# SPDX-License-Identifier: GPL-3.0-or-later
"""Counts of each kind of data of a source, fast enough for each redraw of the sidebar."""

from __future__ import annotations

from bpy.types import Context, Object

from ..mesh_data import Role, count_layers
from ..scene.mesh_facts import latest_facts
from .preflight import evaluated_data


def inventory(context: Context, source: Object) -> dict[str, int]:
    """Counts by kind, see `adapters.DATA`, without kinds that are not known yet or cannot be counted."""
    mesh = evaluated_data(context, source) or source.data
    layers, keys, known = count_layers(mesh), source.data.shape_keys, latest_facts(source)
    counts = {role.value: layers[role] for role in Role} | {
        "vertex_groups": len(source.vertex_groups),
        "shape_keys": 0 if keys is None else len(keys.key_blocks) - 1,
        "materials": sum(slot.material is not None for slot in source.material_slots),
        "custom_normals": int(mesh.has_custom_normals),
    }
    return counts if known is None else counts | {"edges": len(known.marks)}
