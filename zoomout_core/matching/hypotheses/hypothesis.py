# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses: initial maps between two shapes, which are refined and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.anchors import Anchors
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class HypothesisTuning(Tuning, set_by="correspondence"):
    """The sizes of hypotheses, and when two are the same."""

    same_map: float = tuned(0.05, "1", 0, 1)  # maps are the same if images differ by less of their variance
    anchored_size: int = tuned(8, "eigenfunctions", 2, 1000)  # of a map by a few places, such as landmarks
    dense_size: int = tuned(20, "eigenfunctions", 2, 1000)  # of a map of all vertices that is given


HYPOTHESES = HypothesisTuning()


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A small functional map and where it comes from."""

    origin: str  # name for the report
    functional_map: Floats  # (k_target, k_source)
    anchors: Anchors | None = None  # constraints while maps are compared, or None
    final_anchors: Anchors | None = None  # of the final map; hypotheses would prevent convergence


def alike(places: Sequence[Floats], tolerance: float) -> Booleans:
    """(m, m) which of m maps are the same, by the places (s, d) of the images of all samples.

    Their mean squared difference is then at most `tolerance`, as a part of the variance of the first one's places.
    """
    means = np.stack([place.mean(axis=0) for place in places])
    flat = np.stack([np.ravel(place - mean) for place, mean in zip(places, means, strict=True)]).astype(np.float32)
    spread = (flat**2).sum(axis=1)
    shift = ((means[:, None] - means) ** 2).sum(axis=2) * len(places[0])
    distance = spread[:, None] + spread - 2 * flat @ flat.T + shift
    return np.asarray(distance <= tolerance * spread[:, None])
