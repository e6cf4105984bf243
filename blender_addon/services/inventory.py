"""How much of each kind of data a source has, by counts that are at hand whenever the sidebar is drawn."""

from __future__ import annotations

from bpy.types import Context, Object

from ..mesh_data import Role, count_layers
from ..scene.mesh_facts import facts
from .preflight import seen_mesh


def inventory(context: Context, source: Object) -> dict[str, int]:
    """How many there are of each of `adapters.DATA`; one that is not yet known, or cannot be counted, is missing."""
    mesh = seen_mesh(context, source) or source.data
    layers, keys, known = count_layers(mesh), source.data.shape_keys, facts(source)
    counts = {role.value: layers[role] for role in Role} | {
        "vertex_groups": len(source.vertex_groups),
        "shape_keys": 0 if keys is None else len(keys.key_blocks) - 1,
        "materials": sum(slot.material is not None for slot in source.material_slots),
        "custom_normals": int(mesh.has_custom_normals),
    }
    return counts if known is None else counts | {"edges": len(known.marks)}
