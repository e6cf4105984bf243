# SPDX-License-Identifier: GPL-3.0-or-later
"""The names that an artist gave the loose parts of a source."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from bpy.types import Context

from zoomout_core.arrays import Floats, Integers

from ..mesh_data import EvaluatedObject, ObjectPair
from ..mesh_data.arrays import read_array
from ..scene.pair import evaluated_sources


class LabelledFaces(NamedTuple):
    """The faces of joined sources, with the names of their objects and materials."""

    labels: list[str]
    label: Integers  # (f,) the number of each face's label
    vertex: Integers  # (f,) a vertex of each face
    area: Floats  # (f,) the area of each face

    def name_components(self, component: Integers) -> list[str]:
        """The name of each connected component, from the component (n,) of each vertex of the joined sources.

        It is the object's name, and, where components of the object have several materials, that of the material on
        most of the component's area.
        """
        shares = np.zeros((component.max() + 1, len(self.labels)))
        # A component without area has a name, too.
        np.add.at(shares, (component[self.vertex], self.label), self.area + np.finfo(float).tiny)
        return [self.labels[largest] for largest in shares.argmax(axis=1)]


def read_labels(context: Context, pair: ObjectPair) -> LabelledFaces:
    """Read the names of objects and materials on the faces of a pair's sources."""
    with evaluated_sources(context, pair) as sources:
        return _labelled_faces(sources)


def _labelled_faces(sources: Sequence[EvaluatedObject]) -> LabelledFaces:
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
    return LabelledFaces(labels, label, vertex, area)
