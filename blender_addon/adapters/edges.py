# SPDX-License-Identifier: GPL-3.0-or-later
"""Seams, sharp edges, creases and other marks of edges and vertices."""

from __future__ import annotations

from dataclasses import dataclass

from bpy.types import Object

from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import Attribute, Domain, Kind
from zoomout_core.transfer.uv.chart import uv_seams

from .. import mesh_data
from .adapter import Adapter, Remarks, TransferJob, TransferRequest


@dataclass
class MarkAdapter:
    """Marks of one label, see `mesh_data.read_marks`.

    Attributes:
        marks: the source's, after the transfer the target's.
        present: those that the target already has, if any.
    """

    marks: Attribute
    present: Attribute | None
    kind: str = "edges"

    @property
    def names(self) -> list[str]:
        return [self.marks.name]

    def transfer(self, job: TransferJob) -> None:
        transferred = job.transfer(self.marks, self.marks.name)
        self.marks = job.blend_values(transferred, self.present)

    def write(self, target: Object) -> None:
        mesh_data.write_marks(target.data, self.marks)


@dataclass
class SeamAdapter:
    """Seams between the islands of a UV map that is transferred, too; the source's seams would duplicate them.

    Attributes:
        uv_map: its name.
        replaces: whether the source marks seams, which these replace; otherwise they do not count as transferred.
        present: the seams that the target already has, if any.
        marks: the target's, once they are computed.
    """

    uv_map: str
    replaces: bool
    present: Attribute | None
    marks: Attribute | None = None
    kind: str = "edges"

    @property
    def names(self) -> list[str]:
        return [mesh_data.SEAMS] if self.replaces else []

    def transfer(self, job: TransferJob) -> None:
        with stage("Marking seams"):
            seams = uv_seams(job.pair.target, job.uv_maps[self.uv_map].values)
        self.marks = job.blend_values(Attribute(mesh_data.SEAMS, Domain.EDGE, Kind.BOOLEAN, seams), self.present)
        job.remarks.add([message("Seams were marked where the islands of '{uv_map}' meet.", uv_map=self.uv_map)])

    def write(self, target: Object) -> None:
        if self.marks is not None:
            mesh_data.write_marks(target.data, self.marks)


def collect(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    """The source's marks, if requested."""
    if "edges" not in request.data:
        return []
    present = {marks.name: marks for marks in mesh_data.read_marks(request.target.data)}
    found: list[Adapter] = [
        MarkAdapter(marks, present.get(marks.name)) for marks in mesh_data.read_joined_marks(request.sources)
    ]
    active = mesh_data.read_joined_active_layers(request.sources).uv
    if "uv_maps" not in request.data or active is None:
        return found
    others = [adapter for adapter in found if mesh_data.SEAMS not in adapter.names]
    return [SeamAdapter(active, len(others) < len(found), present.get(mesh_data.SEAMS)), *others]
