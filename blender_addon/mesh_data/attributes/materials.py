# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials of objects and faces."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from bpy.types import Mesh, Object

from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Domain, Kind

from ..arrays import read_array


def read_materials(obj: Object, mesh: Mesh) -> tuple[list[str | None], Attribute]:
    """The full names of the materials in an object's slots (None where empty), and each face's slot.

    Slot numbers beyond the last slot are read as the last, as Blender displays them.
    """
    names = [material and material.name_full for material in mesh.materials]
    for i, slot in enumerate(obj.material_slots[: len(names)]):
        if slot.link == "OBJECT":
            names[i] = slot.material and slot.material.name_full
    slots = np.clip(read_array(mesh.polygons, "material_index", np.int32), 0, max(0, len(names) - 1))
    return names, Attribute(message("materials"), Domain.FACE, Kind.LABEL, slots)


def write_materials(obj: Object, names: Sequence[str | None], slots: Attribute) -> None:
    """Assign the materials in `slots` to faces, by name; missing slots are appended."""
    present, _ = read_materials(obj, obj.data)
    by_name = {material.name_full: material for material in bpy.data.materials}
    used, face_slot = np.unique(slots.values, return_inverse=True)
    for name in (names[slot] for slot in used):
        if name not in present:
            obj.data.materials.append(by_name[name] if name else None)
            present.append(name)
    own = np.array([present.index(names[slot]) for slot in used], dtype=np.int32)
    obj.data.polygons.foreach_set("material_index", own[face_slot.reshape(-1)])
