# SPDX-License-Identifier: GPL-3.0-or-later
"""The names that an artist gave the loose parts of a source."""

from __future__ import annotations

import numpy as np
from bpy.types import Context

from ..mesh_data import EvaluatedObject, ObjectPair
from ..scene.pair import evaluated_sources


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
