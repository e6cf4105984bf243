# SPDX-License-Identifier: GPL-3.0-or-later
"""The request, the transfer job and the protocol that the adapters of all kinds of data share."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from bpy.types import Mesh, Object

from zoomout_core.arrays import Booleans
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import message, plural
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import Attribute, Blend, map_target, transfer_along
from zoomout_core.transfer.blend import blend
from zoomout_core.transfer.mapped_target import MappedTarget

from ..mesh_data import EvaluatedObject, ObjectPair
from ..storage.stored_match import Match
from .settings import Settings


@dataclass(frozen=True, eq=False)
class TransferRequest:
    """Which data to transfer, from which objects to which, and how.

    Attributes:
        source: the object that has the data, as it is in the file.
        evaluated: the evaluated object.
        mesh: the evaluated mesh.
        target: the object that receives the data.
        data: the requested kinds of data, see `DATA`.
        settings: how to transfer it.
        blend: how to blend it with the target's own.
        others: further sources, where the target matches several.
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
        """All sources, `source` first."""
        return EvaluatedObject(self.source, self.evaluated, self.mesh), *self.others

    @property
    def replaces(self) -> bool:
        """Whether the transfer replaces all of the target's data."""
        return self.blend.replaces and self.settings.without_partner == "fill"


@dataclass
class Remarks:
    """Remarks for the user.

    Attributes:
        skipped: the reason why data is not transferred, by its name.
        notes: sentences.
    """

    skipped: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, notes: Iterable[str]) -> None:
        """Add sentences, each only once: several attributes may give the same one."""
        self.notes.extend(note for note in notes if note not in self.notes)


@dataclass(frozen=True, eq=False)
class TransferJob:
    """One transfer from a source to a target: match, surfaces, settings, and the UV maps so far.

    Attributes:
        match: maps the target to the source.
        pair: the surfaces of both.
        remarks: collects remarks for the user.
        settings: how to transfer data.
        blend: how to blend it with the target's own.
        uv_maps: UV maps transferred so far, by name.
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
            attribute: an attribute of the source.
            what: its name in the progress.
            source: the source's surface, if in another pose or space than in the match.
            target: the same for the target.
            options: options of the attribute's kind.
        """
        with stage(message("Transferring {what}", what=what)):
            transferred = transfer_along(attribute, self._mapped_target(source, target), **options)
        self.remarks.add(transferred.notes)
        return transferred

    def along(self, match: Match) -> TransferJob:
        """The same transfer along another match."""
        return replace(self, match=match, _mapped_targets={})

    def _mapped_target(self, source: Surface | None, target: Surface | None) -> MappedTarget:
        """The mapped target, with other surfaces than its own if given; cached for the next attribute."""
        if (source, target) not in self._mapped_targets:
            own = self._mapped_targets[None, None]
            self._mapped_targets[source, target] = replace(
                own, source=source or own.source, target=target or own.target
            )
        return self._mapped_targets[source, target]

    def blend_values(
        self,
        transferred: Attribute,
        present: Attribute | None,
        sharing: Collection[str] = (),
        lacking: Collection[int] = (),
    ) -> Attribute:
        """Blend a transferred attribute with the target's own, see `blend`.

        Vertices that map to sources without it (`lacking`, numbers of sources) keep their values.
        """
        how, outside = self.blend, self._on_sources(lacking)
        if self.kept.any() or outside.any():
            how = replace(how, mask=(1.0 if how.mask is None else np.asarray(how.mask)) * ~(outside | self.kept))
        if self.kept.any():
            note = plural(
                int(self.kept.sum()),
                "1 vertex without a partner keeps its data.",
                "{count:,} vertices without a partner keep their data.",
            )
            self.remarks.add([note])
        if outside.any():
            names = ", ".join(f"'{self.pair.source_names[number]}'" for number in lacking)
            note = plural(
                int(outside.sum()),
                "{layer}: 1 vertex is on an object without this data ({sources}), and keeps its data.",
                "{layer}: {count:,} vertices are on objects without this data ({sources}), and keep their data.",
                layer=transferred.name,
                sources=names,
            )
            self.remarks.add([note])
        return transferred if how.replaces else blend(transferred, present, self.pair.target, how, sharing)

    @cached_property
    def kept(self) -> Booleans:
        """(n_t,) which vertices of the target keep their data, because they have no partner on the source."""
        has_partner = self.match.has_partner
        if has_partner is None or self.settings.without_partner == "fill":
            return np.zeros(len(self.match.confidence), dtype=bool)
        return ~has_partner

    def _on_sources(self, sources: Collection[int]) -> Booleans:
        """(n_t,) which vertices of the target map to one of some sources, given by their numbers."""
        first = np.cumsum([len(source.triangles) for source in self.pair.sources])
        return np.isin(np.searchsorted(first, self.match.surface_map.triangle, side="right"), list(sources))


class Adapter(Protocol):
    """Chosen data of one kind: it has the source's values until `transfer`, then the target's.

    It refers to no Blender data, which may be freed during a long transfer.
    """

    @property
    def kind(self) -> str:
        """The kind of data, one of `DATA`."""

    @property
    def names(self) -> list[str]:
        """Names of the data, for the report."""

    def transfer(self, job: TransferJob) -> None:
        """Replace the source's values by the target's; runs in a thread, which must not touch `bpy`."""

    def write(self, target: Object) -> None:
        """Write the values to the target."""
