# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets that are one half, to which a Mirror modifier adds the other: they are matched as the visible whole.

The modifier adds vertices after the mesh's own ones, so that the match of these is the first part.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class HalfResult(zo.MatchResult):
    """The match of a half, as a part of the match of the whole; other attributes are those of the whole.

    Attributes:
        whole: the match of the whole.
        half: the surface of the half, which has the first vertices of the whole.
    """

    whole: zo.MatchResult
    half: zo.Surface

    @classmethod
    def of(cls, whole: zo.MatchResult, half: zo.Surface) -> HalfResult:
        """The part of a whole's match for its half."""
        count, mapped = len(half.vertices), whole.surface_map
        given = {field.name: getattr(whole, field.name) for field in fields(zo.MatchResult)} | {
            "surface_map": zo.SurfaceMap(mapped.triangle[:count], mapped.barycentric[:count], mapped.source_triangles),
            "confidence": whole.confidence[:count],
            "has_partner": whole.has_partner[:count],
            "filled": whole.filled[:count],
            "torn": whole.torn[:count],
        }
        return cls(**given, whole=whole, half=half)

    @property
    def arrived(self) -> Floats:
        """(c,) the part of the whole target's area that receives from each component of the source."""
        return self.whole.arrived

    @property
    def verdict(self) -> zo.Verdict:
        """The verdict on the match of the whole."""
        return self.whole.verdict

    @property
    def share_without_partner(self) -> float:
        """The fraction of the half's area without a partner on the source, in [0, 1]."""
        return self.half.share_of_area(~self.has_partner)

    def outline(self, candidate: int) -> tuple[Integers, Integers]:
        """The outline of a candidate of the whole, on the half."""
        vertices, images = super().outline(candidate)
        own = vertices < len(self.half.vertices)
        return vertices[own], images[own]

    def use(self, candidate: int) -> zo.MatchResult:
        """The result of another candidate, by its number."""
        return HalfResult.of(self.whole.use(candidate), self.half)
