# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of faces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from bpy.types import Object

from zoomout_core.messages import message
from zoomout_core.transfer import Attribute

from .. import mesh_data
from .adapter import Adapter, Remarks, TransferJob, TransferRequest


@dataclass
class MaterialAdapter:
    """Materials.

    Attributes:
        materials: None, then the materials in the source's slots, see `mesh_data.read_materials`, then those in the
            target's slots if both are blended.
        face_slots: each face's index in that list.
        present: the same for the target's faces.
        lacking: numbers of the sources that have no materials.
    """

    materials: list[str | None]
    face_slots: Attribute
    present: Attribute | None
    lacking: tuple[int, ...]
    kind: str = "materials"

    @property
    def names(self) -> list[str]:
        return [self.materials[slot] or "(none)" for slot in np.unique(self.face_slots.values)]

    def transfer(self, job: TransferJob) -> None:
        transferred = job.transfer(self.face_slots, message("materials"))
        self.face_slots = job.blend_values(transferred, self.present, lacking=self.lacking)

    def write(self, target: Object) -> None:
        mesh_data.write_materials(target, self.materials, self.face_slots)


def collect(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    """The source's materials, if it has any and they are requested."""
    materials, face_slots, lacking = mesh_data.read_joined_materials(request.sources)
    if not materials or "materials" not in request.data:
        return []
    listed = [None, *materials]
    face_slots = replace(face_slots, values=face_slots.values + 1)
    if request.replaces and not lacking:
        return [MaterialAdapter(listed, face_slots, None, lacking)]
    theirs, present = mesh_data.read_materials(request.target, request.target.data)
    filled = np.array([name is not None for name in theirs] or [False])[present.values]
    present = replace(present, values=np.where(filled, present.values + len(listed), 0))
    return [MaterialAdapter(listed + theirs, face_slots, present, lacking)]
