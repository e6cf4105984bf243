# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost of a registered fragment by the area that it shares with the other one.

Two fragments may share any part of their area, so a large overlap is no evidence: a right map may leave most of a
fragment beyond a cut. The evidence is how much alike the fragments are where they overlap, by the areas around places
and by their curvature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans
from zoomout_core.matching.partial.part_registration import RegisteredPart
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.ranking.scores import correlation
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FragmentOverlapTuning(Tuning, set_by="official"):
    """The cost of a registered fragment by its overlap; lengths are those of the larger shape at unit area.

    The weights were fitted to 20 pairs of cut dogs, cats and cows, by a conditional logit. If each pair in turn is left
    out, the right map is the first of about 20 for 13 of 19 pairs that have one, and for 9 by the fit of a part alone.
    """

    residual: float = tuned(0.05, "length", 0, 10)  # maximum distance between surfaces that overlap
    agreement: float = tuned(0.5, "1", -1, 1)  # minimum cosine between their normals
    unlikeness: float = tuned(1.2, "1", 0, 100)  # weight of the log mean unlikeness of places and their images
    curvature: float = tuned(1.5, "1", 0, 100)  # weight of the correlation of curvature
    # Weight of the log share of the fragment that is not beyond a cut. The weight 1 of the fit of a part prefers wrong
    # maps with a large overlap. Without any, a limb fits too well that touches the other fragment with its tip.
    within: float = tuned(0.5, "1", 0, 100)


FRAGMENT_OVERLAP = FragmentOverlapTuning()
# Name of the score that orders maps of fragments: the lowest is the most likely.
OVERLAP_COST = "overlap"
# Added to the unlikeness, which vanishes between two meshes of one surface; a hundredth of its largest value.
UNLIKENESS_FLOOR = 0.01
# Minimum share of the fragment that is not beyond a cut, in the logarithm.
MIN_SHARE = 1e-3
# Only the coarsest scale of curvature is compared: details differ between species.
COARSEST = slice(0, 1)


def overlap_cost(registered: RegisteredPart, region: Region) -> float:
    """The cost of a registered fragment by its overlap, beside the cost of its deformation; the lowest is the best.

    Without an overlap, the fragments are as unlike as any.
    """
    areas = region.part.shape.basis.areas
    share = max(float(areas @ ~registered.on_cut / areas.sum()), MIN_SHARE)
    overlaps = registered.is_near & ~registered.on_cut & (registered.residual < FRAGMENT_OVERLAP.residual)
    overlaps &= registered.agreement > FRAGMENT_OVERLAP.agreement
    cost = FRAGMENT_OVERLAP.unlikeness * np.log(_unlikeness(registered, region, overlaps) + UNLIKENESS_FLOOR)
    cost -= FRAGMENT_OVERLAP.curvature * _curvature_correlation(registered, region, overlaps)
    return float(cost - FRAGMENT_OVERLAP.within * np.log(share))


def _unlikeness(registered: RegisteredPart, region: Region, overlaps: Booleans) -> float:
    """The mean unlikeness of places and their images, in [0, 1], where vertices (n,) overlap."""
    part, whole = region.part.shape, region.whole.shape
    at = part.search.samples[: len(region.part.between)]
    weights = region.part.areas * overlaps[at]
    if not weights.any():
        return 1.0
    images = whole.voronoi_cell[registered.closest.vertex[at]]
    return float(np.average(region.unlike[np.arange(len(at)), images], weights=weights))


def _curvature_correlation(registered: RegisteredPart, region: Region, overlaps: Booleans) -> float:
    """The correlation between the curvature of vertices and that of their images, where vertices (n,) overlap."""
    part, whole = region.part.shape, region.whole.shape
    areas = part.basis.areas * overlaps
    if not areas.any():
        return 0.0
    there = registered.closest.interpolate(whole.vertex_curvature[:, COARSEST])
    return float(correlation(part.vertex_curvature[:, COARSEST], there, areas / areas.sum()))
