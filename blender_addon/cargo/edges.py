"""Seams, sharp edges, creases and other marks of edges and vertices."""

from __future__ import annotations

from dataclasses import dataclass

from bpy.types import Object

from zoomout_core.progress import Steps
from zoomout_core.transfer import Attribute

from .. import mesh_data
from .cargo import Cargo, Origin, Remarks, Way


@dataclass
class MarkCargo:
    """Marks of one label, see `mesh_data.read_marks`.

    Attributes:
        marks: those of the source, then those of the target.
        present: those that the target has already, if it has any.
    """

    marks: Attribute
    present: Attribute | None
    kind: str = "edges"

    @property
    def names(self) -> list[str]:
        return [self.marks.name]

    def carry(self, way: Way) -> Steps[None]:
        carried = yield from way.carry(self.marks, self.marks.name)
        self.marks = way.blended(carried, self.present)

    def write(self, target: Object) -> None:
        mesh_data.write_marks(target.data, self.marks)


def pack(origin: Origin, remarks: Remarks) -> list[Cargo]:
    """The marks that the source has, if they are asked for."""
    if "edges" not in origin.data:
        return []
    present = {marks.name: marks for marks in mesh_data.read_marks(origin.target.data)}
    return [MarkCargo(marks, present.get(marks.name)) for marks in mesh_data.read_marks(origin.mesh)]
