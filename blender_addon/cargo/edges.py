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
    """Marks of one label, see `mesh_data.read_marks`."""

    marks: Attribute
    kind: str = "edges"

    @property
    def names(self) -> list[str]:
        return [self.marks.name]

    def carry(self, way: Way) -> Steps[None]:
        self.marks = yield from way.carry(self.marks, self.marks.name)

    def write(self, target: Object) -> None:
        mesh_data.write_marks(target.data, self.marks)


def pack(origin: Origin, remarks: Remarks) -> list[Cargo]:
    """The marks that the source has, if they are asked for."""
    return [MarkCargo(marks) for marks in mesh_data.read_marks(origin.mesh)] if "edges" in origin.data else []
