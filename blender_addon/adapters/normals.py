# SPDX-License-Identifier: GPL-3.0-or-later
"""Custom normals."""

from __future__ import annotations

from dataclasses import dataclass

from bpy.types import Object

import zoomout_core as zo
from zoomout_core.messages import message
from zoomout_core.transfer import Attribute

from .. import mesh_data
from .adapter import Adapter, Remarks, TransferJob, TransferRequest


@dataclass
class NormalAdapter:
    """Custom normals of face corners.

    Attributes:
        normals: the source's in world space, after the transfer the target's in the space of its mesh.
        target: surface of the target's own mesh, at rest, for which normals are stored.
        present: the normals that it has.
    """

    normals: Attribute
    target: zo.Surface
    present: Attribute
    kind: str = "custom_normals"

    @property
    def names(self) -> list[str]:
        return [self.normals.name]

    def transfer(self, job: TransferJob) -> None:
        job.note_replaced(message("custom normals"))
        self.normals = job.transfer(self.normals, message("custom normals"), target=self.target)
        self.normals = job.keep_values(self.normals, self.present)

    def write(self, target: Object) -> None:
        mesh_data.write_custom_normals(target.data, self.normals)


def collect(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    """The source's custom normals, if it has any and they are requested."""
    if "custom_normals" not in request.data:
        return []
    flat = [source.name for source, *_ in request.sources if mesh_data.is_flat(source)]
    if flat:
        remarks.skipped[message("custom normals")] = message(
            "'{name}' has a scale of zero, so its normals have no direction", name=flat[0]
        )
        return []
    normals = mesh_data.read_joined_normals(request.sources)
    if normals is None:
        return []
    present = mesh_data.read_own_normals(request.target.data)
    return [NormalAdapter(normals, mesh_data.read_surface_at_rest(request.target), present)]
