"""Materials of faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bpy.types import Object

from zoomout_core.progress import Steps
from zoomout_core.transfer import Attribute

from .. import mesh_data
from .cargo import Cargo, Origin, Remarks, Way


@dataclass
class MaterialCargo:
    """Materials.

    Attributes:
        materials: what the source's slots hold, see `mesh_data.read_materials`.
        face_slots: each face's slot.
    """

    materials: list[str | None]
    face_slots: Attribute
    kind: str = "materials"

    @property
    def names(self) -> list[str]:
        return [self.materials[slot] or "(none)" for slot in np.unique(self.face_slots.values)]

    def carry(self, way: Way) -> Steps[None]:
        self.face_slots = yield from way.carry(self.face_slots, "materials")

    def write(self, target: Object) -> None:
        mesh_data.write_materials(target, self.materials, self.face_slots)


def pack(origin: Origin, remarks: Remarks) -> list[Cargo]:
    """The source's materials, if it has any."""
    materials, face_slots = mesh_data.read_materials(origin.evaluated, origin.mesh)
    return [MaterialCargo(materials, face_slots)] if materials and "materials" in origin.data else []
