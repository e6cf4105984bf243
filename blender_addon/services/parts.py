# SPDX-License-Identifier: GPL-3.0-or-later
"""The names that an artist gave the loose parts of a source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bpy.types import Context

from ..mesh_data import EvaluatedObject, ObjectPair
from ..mesh_data.arrays import read_array
from ..scene.pair import evaluated_sources


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
