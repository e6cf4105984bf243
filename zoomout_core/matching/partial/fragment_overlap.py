# SPDX-License-Identifier: GPL-3.0-or-later
"""How much alike two fragments are where a registered one overlaps the other.

Fragments may share any part of their area, so a large overlap is no evidence for a map: a right one may leave most of a
fragment beyond a cut. What counts is that the shared area looks alike, before and after one fragment is bent to the
other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

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

    residual: float = tuned(0.05, "length", 0, 10)  # farthest from the other fragment that a place overlaps it
    agreement: float = tuned(0.5, "1", -1, 1)  # minimum cosine between normals of places that overlap
    unlikeness: float = tuned(1.2, "1", 0, 100)  # weight of the log mean unlikeness of places and their images
    curvature: float = tuned(1.5, "1", 0, 100)  # weight of the correlation of curvature
    # Weight of the log share of the fragment that is not beyond a cut. The fit has the weight 1, which prefers wrong
    # maps with a large overlap; with no weight, a limb that touches the other fragment with its tip fits too well.
    within: float = tuned(0.5, "1", 0, 100)


FRAGMENT_OVERLAP = FragmentOverlapTuning()
# Name of the cost of a registered fragment: the lowest is the most likely.
OVERLAP = "overlap"
# The unlikeness of meshes of one surface, which the logarithm ignores.
UNLIKENESS_FLOOR = 0.01


def overlap_cost(registered: RegisteredPart, region: Region, scores: Mapping[str, float], share_weight: float) -> float:
    """The cost of a registered fragment, by its `scores` as a part, corrected by the overlap.

    The `scores` have a fit that rewards the log share that is not beyond a cut with `share_weight`.
    """
    part, whole = region.part.shape, region.whole.shape
    overlaps = (registered.residual < FRAGMENT_OVERLAP.residual) & (registered.agreement > FRAGMENT_OVERLAP.agreement)
    overlaps &= registered.is_near & ~registered.on_cut
    share = max(1 - scores["beyond"], 1e-3)
    cost = scores["fit"] + (share_weight - FRAGMENT_OVERLAP.within) * np.log(share)
    at = part.search.samples[: len(region.part.between)]
    weights = region.part.areas * overlaps[at]
    unlike, alike = 1.0, 0.0
    if weights.any():
        images = whole.voronoi_cell[registered.closest.vertex[at]]
        unlike = np.average(region.unlike[np.arange(len(at)), images], weights=weights)
        areas = part.basis.areas * overlaps
        # Only the coarsest scale counts: details differ between species.
        coarsest = slice(0, 1)
        curvature = registered.closest.interpolate(whole.vertex_curvature[:, coarsest])
        alike = correlation(part.vertex_curvature[:, coarsest], curvature, areas / areas.sum())
    cost += FRAGMENT_OVERLAP.unlikeness * np.log(unlike + UNLIKENESS_FLOOR)
    return float(cost - FRAGMENT_OVERLAP.curvature * alike)
