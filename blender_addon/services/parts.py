# SPDX-License-Identifier: GPL-3.0-or-later
"""The names that an artist gave the parts of a source."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from bpy.types import Context

from zoomout_core.arrays import Integers

from ..mesh_data import EvaluatedObject, ObjectPair
from ..mesh_data.arrays import read_array
from ..scene.pair import evaluated_sources


class LabelledFaces(NamedTuple):
    """The faces of joined sources, with the names of their objects, and of their materials if there are several."""

    labels: list[str]
    label: Integers  # (f,) the number of each face's label


def read_labels(context: Context, pair: ObjectPair) -> LabelledFaces:
    """Read the names of objects and materials on the faces of a pair's sources."""
    with evaluated_sources(context, pair) as sources:
        return _labelled_faces(sources)


def _labelled_faces(sources: Sequence[EvaluatedObject]) -> LabelledFaces:
    labels: list[str] = []
    faces = []
    for source in sources:
        mesh, obj = source.mesh, source.original
        names = [slot.material.name if slot.material else "" for slot in obj.material_slots]
        material = read_array(mesh.polygons, "material_index", np.int32)
        if len({name for name in names if name}) < 2:
            names, material = [""], np.zeros_like(material)
        faces.append(len(labels) + np.clip(material, 0, len(names) - 1))
        labels += [f"{obj.name}: {name}" if name else obj.name for name in names]
    return LabelledFaces(labels, np.concatenate(faces))
