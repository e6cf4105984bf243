# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets that are one half, of which a Mirror modifier makes the other: matched as the whole that is seen.

The modifier leaves a mesh's own vertices before those that it makes, so the match of these is the first part.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import zoomout_core as zo
from zoomout_core.arrays import Integers


@dataclass(frozen=True, eq=False)
class HalfResult(zo.MatchResult):
    """The part of the match of a whole that is of one half; its other attributes are those of the whole.

    Attributes:
        whole: the match of the whole.
        half: the surface that the first vertices of the whole belong to.
    """

    whole: zo.MatchResult
    half: zo.Surface

    @classmethod
    def of(cls, whole: zo.MatchResult, half: zo.Surface) -> HalfResult:
        """The part of a match of a whole."""
        count, mapped = len(half.vertices), whole.surface_map
        given = {field.name: getattr(whole, field.name) for field in fields(zo.MatchResult)} | {
            "surface_map": zo.SurfaceMap(mapped.triangle[:count], mapped.barycentric[:count], mapped.source_triangles),
            "confidence": whole.confidence[:count],
            "has_partner": whole.has_partner[:count],
        }
        return cls(**given, whole=whole, half=half)

    @property
    def share_without_partner(self) -> float:
        """The part of the half's area, in [0, 1], to which nothing on the source corresponds."""
        return self.half.share_of_area(~self.has_partner)

    def outline(self, candidate: int) -> tuple[Integers, Integers]:
        """Where a candidate leads, roughly: that of the whole, on the half."""
        vertices, images = super().outline(candidate)
        own = vertices < len(self.half.vertices)
        return vertices[own], images[own]

    def use(self, candidate: int) -> zo.MatchResult:
        """The result of another candidate, by its number."""
        return HalfResult.of(self.whole.use(candidate), self.half)
