"""What all kinds of data have in common on their way from a source to a target."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any, Protocol

from bpy.types import Mesh, Object

from zoomout_core.progress import Steps, spread
from zoomout_core.transfer import Attribute, transfer_steps

from ..pair import ObjectPair
from ..stored_match import Match


@dataclass(frozen=True, eq=False)
class Origin:
    """Where data comes from and goes to, to choose from.

    Attributes:
        source: the object that has the data, as it is in the file.
        evaluated: the same as its modifiers leave it.
        mesh: the mesh that these leave.
        target: the object that receives the data.
        data: which kinds of it were asked for, see `DATA`.
    """

    source: Object
    evaluated: Object
    mesh: Mesh
    target: Object
    data: Collection[str]


@dataclass
class Remarks:
    """What the user is to know.

    Attributes:
        skipped: a reason for each name that is not transferred.
        notes: sentences.
    """

    skipped: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Way:
    """The way that data takes.

    Attributes:
        match: leads from the target to the source.
        pair: the surfaces of both.
        remarks: what the user is to know of the transfer.
    """

    match: Match
    pair: ObjectPair
    remarks: Remarks

    def carry(self, attribute: Attribute, what: str, **options: Any) -> Steps[Attribute]:
        """An attribute of the source, on the target; `what` it is called in the progress."""
        steps = transfer_steps(attribute, self.match, self.pair.source, self.pair.target, **options)
        carried = yield from spread(steps, 0, 1, f"Transferring {what}")
        self.remarks.notes.extend(carried.notes)
        return carried


class Cargo(Protocol):
    """Data that was chosen: with the source's values until it is carried, then with the target's.

    It holds no Blender data, which may be gone when a long transfer has ended.
    """

    @property
    def kind(self) -> str:
        """Which kind of data it is, of `DATA`."""

    @property
    def names(self) -> list[str]:
        """What it is made of, for the report."""

    def carry(self, way: Way) -> Steps[None]:
        """Put the target's values in place of the source's."""

    def write(self, target: Object) -> None:
        """Write them to the target."""
