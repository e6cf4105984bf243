# SPDX-License-Identifier: GPL-3.0-or-later
"""The surfaces of the two objects of a match, and fingerprints that detect later edits.

A target that is a part of a character may have several sources, which are joined in order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import zoomout_core as zo


@dataclass(frozen=True)
class Fingerprint:
    """Identifies the state of an object, to detect edits; it does not depend on the pose.

    Attributes:
        name: name of the object.
        digest: hash of its content, whether it is mirrored, and the faces of its surface.
        content: hash of its own mesh, see `mesh_data.content_hash`.
        mirrored: whether its matrix mirrors it.
        size: number of vertices and of faces of its surface.
        at_base: whether its surface is its own mesh, before modifiers that were added later change its vertices; else
            it is the evaluated mesh. For a target it always is its own mesh.
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
        sources: evaluated surfaces of the sources; the first one provides the largest share.
        target: the target's own mesh at the evaluated positions.
        source_fingerprints: fingerprints of the sources, taken when they were read.
        target_fingerprint: fingerprint of the target.
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
        """Names of the source objects."""
        return tuple(fingerprint.name for fingerprint in self.source_fingerprints)

    @property
    def source_name(self) -> str:
        """Name of the first source object."""
        return self.source_fingerprints[0].name

    @property
    def target_name(self) -> str:
        """Name of the target object."""
        return self.target_fingerprint.name
