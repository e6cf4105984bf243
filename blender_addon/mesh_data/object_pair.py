# SPDX-License-Identifier: GPL-3.0-or-later
"""The surfaces of two objects of a match, and the fingerprints by which later edits are noticed.

A target that is a part of a character may receive from several objects: then these are the source, joined in order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import zoomout_core as zo


@dataclass(frozen=True)
class Fingerprint:
    """Identifies the state of an object, so that edits are noticed; it does not depend on the pose.

    Attributes:
        name: of the object.
        digest: hash of its content, whether it is mirrored, and the faces of its surface.
        content: of its own mesh, see `mesh_data.content_hash`.
        mirrored: whether its matrix mirrors it.
        size: number of vertices and of faces of its surface.
        at_base: whether this is its own mesh, before modifiers that were added later give it other vertices; else it
            is what they leave. Of a target it always is its own mesh.
    """

    name: str
    digest: str
    content: str
    mirrored: bool
    size: tuple[int, int]
    at_base: bool = False


@dataclass(frozen=True, eq=False)
class ObjectPair:
    """The surfaces of two objects, or of several sources and a target.

    Attributes:
        sources: evaluated; they have the data. The first one gives the largest share.
        target: its own mesh at the evaluated positions; it receives the data.
        source_fingerprints: those of the sources, when they were read.
        target_fingerprint: that of the target.
    """

    sources: tuple[zo.Surface, ...]
    target: zo.Surface
    source_fingerprints: tuple[Fingerprint, ...]
    target_fingerprint: Fingerprint

    @cached_property
    def source(self) -> zo.Surface:
        """All sources as one surface."""
        return self.sources[0] if len(self.sources) == 1 else zo.Surface.joined(self.sources)

    @property
    def source_names(self) -> tuple[str, ...]:
        """Of the sources' objects."""
        return tuple(fingerprint.name for fingerprint in self.source_fingerprints)

    @property
    def source_name(self) -> str:
        """Of the first source's object."""
        return self.source_fingerprints[0].name

    @property
    def target_name(self) -> str:
        """Of the target's object."""
        return self.target_fingerprint.name
