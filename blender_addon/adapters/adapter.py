# SPDX-License-Identifier: GPL-3.0-or-later
"""What the adapters of all kinds of data share: the request, the transfer job, and the protocol that they follow."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from bpy.types import Mesh, Object

from zoomout_core.arrays import Booleans
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import Attribute, Blend, blend, map_target, transfer_along
from zoomout_core.transfer.mapped_target import MappedTarget

from ..mesh_data import EvaluatedObject, ObjectPair
from ..storage.stored_match import Match
from .settings import Settings


@dataclass(frozen=True, eq=False)
class TransferRequest:
    """What is to be transferred, from which objects to which, and how.

    Attributes:
        source: the object that has the data, as it is in the file.
        evaluated: the evaluated object.
        mesh: the evaluated mesh.
        target: the object that receives the data.
        data: which kinds of it were asked for, see `DATA`.
        settings: how it is transferred.
        blend: how it is blended with what the target has.
        others: objects that have data besides the source, where the target lies on several.
    """

    source: Object
    evaluated: Object
    mesh: Mesh
    target: Object
    data: Collection[str]
    settings: Settings
    blend: Blend
    others: Sequence[EvaluatedObject] = ()

    @cached_property
    def sources(self) -> tuple[EvaluatedObject, ...]:
        """All objects that have data, the source first."""
        return EvaluatedObject(self.source, self.evaluated, self.mesh), *self.others

    @property
    def replaces(self) -> bool:
        """Whether nothing is left of what the target has."""
        return self.blend.replaces and self.settings.without_partner == "fill"


@dataclass
class Remarks:
    """What the user is to know.

    Attributes:
        skipped: a reason for each name that is not transferred.
        notes: sentences.
    """

    skipped: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, notes: Iterable[str]) -> None:
        """Add sentences, but those that are there already, as of several attributes."""
        self.notes.extend(note for note in notes if note not in self.notes)


@dataclass(frozen=True, eq=False)
class TransferJob:
    """One transfer from a source to a target: the match, both surfaces, the settings, and UV maps so far.

    Attributes:
        match: leads from the target to the source.
        pair: the surfaces of both.
        remarks: what the user is to know of the transfer.
        settings: how data is transferred.
        blend: how it is blended with what the target has.
        uv_maps: those transferred so far, by name.
    """

    match: Match
    pair: ObjectPair
    remarks: Remarks
    settings: Settings
    blend: Blend
    uv_maps: dict[str, Attribute] = field(default_factory=dict)
    _mapped_targets: dict[tuple[Surface | None, Surface | None], MappedTarget] = field(default_factory=dict)

    def __post_init__(self) -> None:
        own = map_target(self.match, self.pair.source, self.pair.target, self.settings.fill_below)
        self._mapped_targets.setdefault((None, None), own)

    def transfer(
        self,
        attribute: Attribute,
        what: str,
        source: Surface | None = None,
        target: Surface | None = None,
        **options: Any,
    ) -> Attribute:
        """Transfer an attribute of the source to the target.

        Args:
            attribute: of the source.
            what: its name in the progress.
            source: the source's surface in another pose or space than it was matched in.
            target: the same of the target.
            options: of the attribute's kind.
        """
        with stage(message("Transferring {what}", what=what)):
            carried = transfer_along(attribute, self._mapped_target(source, target), **options)
        self.remarks.add(carried.notes)
        return carried

    def along(self, match: Match) -> TransferJob:
        """The same transfer along another match."""
        return replace(self, match=match, _mapped_targets={})

    def _mapped_target(self, source: Surface | None, target: Surface | None) -> MappedTarget:
        """The mapped target, with other surfaces in place of its own if given; cached for the next attribute."""
        if (source, target) not in self._mapped_targets:
            own = self._mapped_targets[None, None]
            self._mapped_targets[source, target] = replace(
                own, source=source or own.source, target=target or own.target
            )
        return self._mapped_targets[source, target]

    def blend_values(
        self,
        carried: Attribute,
        present: Attribute | None,
        sharing: Collection[str] = (),
        lacking: Collection[int] = (),
    ) -> Attribute:
        """A transferred attribute, blended with the one that the target has, see `blend`.

        Vertices that map to sources without it (`lacking`, numbers of sources) retain their values.
        """
        how, outside = self.blend, self._on_sources(lacking)
        if self.kept.any() or outside.any():
            how = replace(how, mask=(1.0 if how.mask is None else np.asarray(how.mask)) * ~(outside | self.kept))
        if self.kept.any():
            self.remarks.add([message("{count} vertices without a partner keep their data.", count=self.kept.sum())])
        if outside.any():
            names = ", ".join(f"'{self.pair.source_names[number]}'" for number in lacking)
            note = message(
                "{layer}: {count} vertices are on objects without this data ({sources}), and keep their data.",
                layer=carried.name,
                count=outside.sum(),
                sources=names,
            )
            self.remarks.add([note])
        return carried if how.replaces else blend(carried, present, self.pair.target, how, sharing)

    @cached_property
    def kept(self) -> Booleans:
        """(n_t,) which vertices of the target stay as they are, for nothing on the source corresponds to them."""
        has_partner = self.match.has_partner
        if has_partner is None or self.settings.without_partner == "fill":
            return np.zeros(len(self.match.confidence), dtype=bool)
        return ~has_partner

    def _on_sources(self, sources: Collection[int]) -> Booleans:
        """(n_t,) whether each vertex of the target lies on one of some sources, given by their numbers."""
        first = np.cumsum([len(source.triangles) for source in self.pair.sources])
        return np.isin(np.searchsorted(first, self.match.surface_map.triangle, side="right"), list(sources))

    def keep_values(self, carried: Attribute, present: Attribute) -> Attribute:
        """A transferred attribute, which is not blended, with what is there where vertices stay as they are."""
        if not self.kept.any():
            return carried
        return blend(carried, present, self.pair.target, Blend(mask=~self.kept))

    def note_replaced(self, what: str) -> None:
        """Say that data of the target is replaced, where others are blended."""
        if not self.blend.replaces:
            note = message(
                "{what}: replaced those of '{target}' instead of blending with them.",
                what=what,
                target=self.pair.target_name,
            )
            self.remarks.add([note])


class Adapter(Protocol):
    """Data of one kind that was chosen: with the source's values until `transfer`, then with the target's.

    It holds no Blender data, which may be freed during a long transfer.
    """

    @property
    def kind(self) -> str:
        """Which kind of data it is, of `DATA`."""

    @property
    def names(self) -> list[str]:
        """What it is made of, for the report."""

    def transfer(self, job: TransferJob) -> None:
        """Put the target's values in place of the source's; in a thread, which must not touch `bpy`."""

    def write(self, target: Object) -> None:
        """Write them to the target."""
