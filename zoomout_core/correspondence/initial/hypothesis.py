"""A guess at the map between two shapes, to be refined and compared with others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from zoomout_core.correspondence.anchors import Anchors
from zoomout_core.surface import Booleans, Floats


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A small functional map and where it comes from.

    Attributes:
        origin: in words, for the report.
        functional_map: (k_target, k_source).
        anchors: what holds the map in place while it is compared with others, if anything does.
        final_anchors: what holds it to the end. Guesses alone would only keep it from settling.
    """

    origin: str
    functional_map: Floats
    anchors: Anchors | None = None
    final_anchors: Anchors | None = None


def is_new(place: Floats, known: Iterable[Floats], tolerance: float) -> bool:
    """Whether a map is none of those that are known already.

    Args:
        place: (s, d) coordinates of the images of all samples.
        known: the same of other maps.
        tolerance: the same map's mean squared difference, as a part of the variance of `place`.
    """
    spread = ((place - place.mean(axis=0)) ** 2).sum()
    return all(((place - other) ** 2).sum() > tolerance * spread for other in known)


def alike(places: Sequence[Floats], tolerance: float) -> Booleans:
    """(m, m) which of m maps are the same as which, by the coordinates (s, d) of their images; see `is_new`."""
    flat = np.stack([np.ravel(place - place.mean(axis=0)) for place in places]).astype(np.float32)
    means = np.stack([place.mean(axis=0) for place in places])
    spread = (flat**2).sum(axis=1)
    shift = ((means[:, None] - means) ** 2).sum(axis=2) * len(places[0])
    distance = spread[:, None] + spread - 2 * flat @ flat.T + shift
    return np.asarray(distance <= tolerance * spread[:, None])
