# SPDX-License-Identifier: GPL-3.0-or-later
"""A candidate: a map between two shapes that is compared with others."""

from __future__ import annotations

from dataclasses import dataclass

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.anchors import Anchors
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.partial.part_candidates import PartCandidate
from zoomout_core.messages import probability
from zoomout_core.runtime.summary import Summary


@dataclass(frozen=True, eq=False, repr=False)
class Candidate(Summary):
    """A map between two shapes' samples, with its scores."""

    origin: str  # name of the hypothesis that it was refined from
    reverses_orientation: bool  # whether it reverses the orientation, as a mirror image does
    # Whether it maps the target's mirror image. This equals `reverses_orientation`, unless the outer side of an open
    # surface is unknown: then it may be a map onto the other side.
    mirrored: bool
    functional_map: Floats  # (k_target, k_source)
    reverse_functional_map: Floats  # (k_source, k_target), of the map found in the other direction
    sample_map: Integers  # (s_t,) for each search sample of the target the number of its source sample
    anchors: Anchors | None  # constraints of the search at all vertices
    final_anchors: Anchors | None  # constraints of the final map, if the user gave any
    certainty: float  # probability, in [0, 1], that this map is right, among the maps of the same orientation
    # Commutativity, frequency, distance, curvature, handedness (see `scores_of`), disagreements with constraints, and
    # their total; the lowest total is the most likely map.
    scores: dict[str, float]
    # The placement of one shape as a part of the other, from which the map is found by registration; None for maps of
    # two whole shapes.
    part_match: PartCandidate | None = None
    # Its map between the shapes' meshes, and the functional map (k, k) of that, if it was refined to be ranked.
    refined: tuple[SurfaceMap, Floats] | None = None
    distortion: Floats | None = None  # (n_t,) `local_distortion` of that map
    turns: int = 1  # number of maps, this one included, that differ only by rotational symmetries of one of the shapes

    def _summary(self) -> dict[str, str]:
        return {
            "origin": self.origin,
            "certainty": probability(self.certainty),
            "orientation": "reversed" if self.reverses_orientation else "kept",
            "size": " x ".join(map(str, self.functional_map.shape)),
        }
