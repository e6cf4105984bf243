# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a surface by the names of its objects and materials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.mesh.surface import Surface


class PartName(NamedTuple):
    """How an artist calls a part of a source.

    Attributes:
        label: the name for the user: that of the object, followed by that of the material if the object has several.
            The object's name is left out if there is only one object.
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
    loose, unnamed = np.zeros(count, dtype=np.int64), (name == 0) & (material == 0)
    if unnamed.any():  # computing the components may take longer than all else before a first look at a match
        loose[unnamed] = source.components[source.triangles[unnamed, 0]]
    shape = len(names), len(looks), int(loose.max()) + 1
    keys, part = np.unique(np.ravel_multi_index((name, material, loose), shape), return_inverse=True)
    found = np.stack(np.unravel_index(keys, shape), axis=1).tolist()
    counts = np.bincount([first for first, _, _ in found])
    alone = np.count_nonzero(counts) == 1
    return NamedParts([_part_name(str(names[i]), str(looks[j]), k, counts[i] > 1, alone) for i, j, k in found], part)


def _part_name(name: str, material: str, loose: int, divided: bool, alone: bool) -> PartName:
    look = material if divided or not name else ""
    label = look if alone and look else ": ".join(filter(None, (name, look)))
    return PartName(label or f"part {loose}", name, material)
