# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the assets of which a target is a part, such as a bust.

The surroundings of places choose a few assets, each with the scale of the target. The target is placed on these at that
scale, and registered with the one on which it fits best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from zoomout_core.library.bodies import HULL, Body, LibraryAsset, analyse_body, match_options
from zoomout_core.library.surroundings import PartDifference, PartSurroundings
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.incomplete_shape import at_scale
from zoomout_core.matching.partial.part_candidates import PART_CANDIDATES
from zoomout_core.matching.partial.part_match import PART_MATCH, match_part
from zoomout_core.matching.partial.unknown_scale import RoughPlace, rough_places
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.result import MatchResult, make_result
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class WholesTuning(Tuning, set_by="library"):
    """Which parts are placed, and on how many assets."""

    placed: int = tuned(4, "assets", 1, 1000)  # assets with the most similar surroundings
    # Minimum variation of surroundings of a part that is placed. A bowl, a sheet and a tube have 0.03 to 0.05, and fit
    # robots and rats with certainties up to 0.95; 17 heads, busts and upper bodies have 0.21 to 0.48.
    min_variation: float = tuned(0.1, "1", 0, 100)
    # If a place is at least this certain, and the target is nearly a whole there, it is searched for as a whole.
    # Characters with open clothes have 0.89 and 0.98 on their own assets.
    likely: float = tuned(0.5, "probability", 0, 1)


WHOLES = WholesTuning()
# Fractions of the progress at the end of the comparison, and of the rough placement.
COMPARED, PLACED = 0.15, 0.7


class FoundWhole(NamedTuple):
    """An asset on which a part was placed."""

    path: Path
    difference: float  # of the surroundings
    certainty: float  # probability that the place is right
    misfit: float  # the weighted geometric mean of the errors of normals and lengths
    match: MatchResult | None = None  # of the first asset only


def find_wholes(part: Body, assets: Sequence[LibraryAsset], count: int | None = None) -> list[FoundWhole] | None:
    """Find the assets of which a body may be a part.

    Args:
        part: the target's body.
        assets: the assets to search.
        count: the number of assets on which it is placed; by default `WholesTuning.placed`.

    Returns:
        The assets, the most certain first; empty if the body has no features, and None if it is nearly a whole.
    """
    shape = analyse_body(part.surface)
    with stage("Placing a part", 0.0, COMPARED):
        surroundings = PartSurroundings.of(shape)
        if surroundings.variation < WHOLES.min_variation:
            return []
        compared = sorted((_compare(asset, surroundings) for asset in assets), key=lambda each: each.difference.mean)
    chosen = [each for each in compared if np.isfinite(each.difference.mean)][: count or WHOLES.placed]
    found = []
    for number, each in enumerate(chosen):
        share = (PLACED - COMPARED) / len(chosen)
        with portion(COMPARED + share * number, COMPARED + share * (number + 1)):
            place = rough_places(shape, analyse_body(each.whole.surface), [each.difference.scale])[0]
        if place.certainty >= WHOLES.likely and _is_nearly_whole(place):
            return None
        found.append((place, each))
    found.sort(key=lambda pair: -pair[0].certainty)
    if not found:
        return []
    if _is_nearly_whole(found[0][0]):
        return None
    (place, first), *others = found
    with portion(PLACED, 1.0):
        result = _match(first.whole, part, shape, place)
    misfit = _misfit(result.candidates[result.chosen].scores["fit"])
    best = FoundWhole(first.path, first.difference.mean, result.certainty, misfit, result)
    return [
        best,
        *(FoundWhole(one.path, one.difference.mean, rough.certainty, _misfit(rough.fit)) for rough, one in others),
    ]


def _is_nearly_whole(place: RoughPlace) -> bool:
    return place.scale**2 > PART_MATCH.nearly_whole


def _misfit(fit: float) -> float:
    """The weighted geometric mean of the errors whose logarithms are the terms of a fit."""
    return float(np.exp(fit / (1 + PART_CANDIDATES.strain)))


@dataclass(frozen=True, eq=False)
class _Compared:
    """An asset, and its body that is most similar to a part."""

    path: Path
    whole: Body
    difference: PartDifference


def _compare(asset: LibraryAsset, part: PartSurroundings) -> _Compared:
    # A coarse hull fuses limbs that touch.
    bodies = [body for kind, body in asset.bodies.items() if kind != HULL] or list(asset.bodies.values())
    compared = [_Compared(asset.path, body, part.compare(body.surroundings)) for body in bodies]
    return min(compared, key=lambda each: each.difference.mean)


def _match(whole: Body, part: Body, shape: ShapeAnalysis, place: RoughPlace) -> MatchResult:
    """The match of a part with a whole, at the scale and from the place that were found."""
    options = match_options()
    shapes = analyse_body(whole.surface), at_scale(shape, place.scale)
    pair = Pair(whole.surface, part.surface, *shapes, options.k_final, options.step)
    return make_result(pair, tuple(match_part(pair, given=[place.places])), 0)
