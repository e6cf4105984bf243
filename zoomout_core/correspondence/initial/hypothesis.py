"""A guess at the map between two shapes, to be refined and compared with others."""

from __future__ import annotations

from dataclasses import dataclass

from zoomout_core.correspondence.anchors import Anchors
from zoomout_core.surface import Floats


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A small functional map and where it comes from.

    Attributes:
        origin: in words, for the report.
        functional_map: (k_target, k_source).
        anchors: what holds the map in place while it is refined, if anything does.
    """

    origin: str
    functional_map: Floats
    anchors: Anchors | None = None
