# SPDX-License-Identifier: GPL-3.0-or-later
"""Match a part and its whole in different units: search for the part at several scales.

Scales compete like regions. Once the part is in place, the distances between images determine its scale more exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale
from zoomout_core.matching.partial.part_candidates import (
    PartCandidate,
    landmark_sets,
    register_places,
    rough_candidates,
)
from zoomout_core.matching.partial.part_match import match_part
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import certainty_of_fit
from zoomout_core.matching.ranking.scores import Disagreement
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class UnknownScaleTuning(Tuning, set_by="partial"):
    """The scales at which a part is searched for, and its certainty; lengths are those of the whole at unit area."""

    # Tried for a part of unit area. Cuts of cats, horses, men and wolves are found at 0.8 to 1.25 times the true one.
    scales: tuple[float, ...] = tuned(tuple(np.geomspace(0.27, 0.98, 5).round(3).tolist()), "1", 1e-3, 10)
    # The same for hands (true scales 0.1 to 0.15) and feet (0.15 to 0.22), which are searched for in regions.
    small_scales: tuple[float, ...] = tuned((0.1, 0.14, 0.19), "1", 1e-3, 1)
    regions: int = tuned(2, "regions", 0, 100)  # of the part, which are searched for on their own to find its scale
    # Number of maps at each scale by which the part is registered coarsely. The right map is among the four with the
    # lowest cost on 16 of 16 pairs (people and cats), but only within one scale: smaller parts have lower costs.
    maps_per_scale: int = tuned(4, "maps", 1, 1000)
    compared: int = tuned(3, "scales", 1, 100)  # number of scales, fitted to their first maps, that are compared
    # A place at another scale is also matched if its certainty is at least this fraction of the best one's. Two scales
    # of a person with missing pieces have .60 and .61, and the first is right.
    nearly: float = tuned(0.9, "1", 0, 1)
    another_scale: float = tuned(1.1, "1", 1, 100)  # scales differ above this factor between them
    far: float = tuned(0.15, "length", 0, 10)  # minimum distance between two places that contribute to the scale
    likely: float = tuned(0.5, "probability", 0, 1)  # higher, as the best of several scales is chosen
    # Certainty of a part in the given unit from which no other unit is tried. Of 12 people with missing pieces that are
    # scaled, two have .53 and .70 in the given unit, where their maps are less exact than in the true one (errors of 27
    # and 30 instead of 20 and 25, x 1000).
    enough: float = tuned(0.75, "probability", 0, 1)
    # If a likely map in the given unit is stretched by less than this factor, that unit is right. The maps of those two
    # people are stretched by 1.21 and 0.85, and that of another cut, whose unit was not looked at, by 0.84. In the
    # right unit, eight maps of people and cats with certainties of .5 to .85 are stretched by 0.90 to 1.07. A search in
    # other units doubles their time, and worsens two of them.
    right_unit: float = tuned(1.14, "1", 1, 100)
    # Certainty of the map of two wholes above which no other unit is tried. If a piece is missing, maps with .57 and
    # .88 are off by 147 and 69 (x 1000), whereas the part in its own unit has .94 and .96 and is off by 23.
    certain: float = tuned(0.9, "probability", 0, 1)
    # Minimum scale of one of two fragments. At 0.33 a certainty of one half requires a fit of -4.5, which one of 16
    # pairs of animals reaches in the same unit.
    of_fragments: float = tuned(0.4, "1", 0, 1)
    # Certainty of the rough place of one of two fragments below which no scale is fitted: a smaller part fits anywhere.
    # On seven pairs of animals three maps were likely, with 0.36, 0.91 and 0.95; lost pairs have at most 0.12.
    min_of_fragments: float = tuned(0.15, "probability", 0, 1)
    one_unit: float = tuned(1.25, "1", 1, 100)  # scales of one unit differ by at most this factor


UNKNOWN_SCALE = UnknownScaleTuning()


def match_at_unknown_scale(
    pair: Pair, disagreement: Callable[[Pair], Disagreement], certainty: float = 0.0
) -> tuple[Pair, list[Candidate]] | None:
    """Match two shapes of unknown units, one of which is a part of the other, in the unit in which the part fits best.

    Parts as small as hands are only searched for if neither a larger part nor the map found before, by its `certainty`,
    is likely. Returns the pair in one unit, in which the larger shape has unit area, and its candidates by certainty.
    None if neither shape is a fragment, or if two fragments overlap nowhere on enough area for a likely map. Two
    fragments are not searched for again in the units of their files.
    """
    shapes = [at_scale(shape, shape.basis.areas.sum() ** -0.5) for shape in (pair.source_shape, pair.target_shape)]
    parts = [number for number, shape in enumerate(shapes) if IncompleteShape(shape).is_fragment]
    if not parts:
        return None

    def place_at_scale(part: int, scale: float, given: Sequence[Integers] = ()) -> tuple[Pair, list[Candidate]]:
        unit, factors = max(scale, 1.0), [1.0, 1.0]
        factors[part] = scale
        source, target = (at_scale(shape, each / unit) for shape, each in zip(shapes, factors, strict=True))
        in_unit = replace(pair, source_shape=source, target_shape=target)
        return in_unit, match_part(in_unit, disagreement(in_unit), given)

    found = []
    for step, part in enumerate(parts):
        known = _scale_in_files(pair, part) if len(parts) > 1 else None
        with portion(0.4 * step / len(parts), 0.4 * (step + 1) / len(parts)):
            places = rough_places(shapes[part], shapes[1 - part], _scales_to_try(known))
        places = [one for one in places if _is_other_unit(one.scale, known)]
        if places:
            found.append((places, part))
    if not found:
        return None
    places, part = max(found, key=lambda one: one[0][0].certainty)
    if len(parts) > 1 and places[0].certainty < UNKNOWN_SCALE.min_of_fragments:
        return None
    matched = []
    chosen = nearly_best(places)
    for step, rough in enumerate(chosen):
        with portion(0.4 + 0.15 * step / len(chosen), 0.4 + 0.15 * (step + 1) / len(chosen)):
            # A larger part is the whole of the other shape, to which the map does not apply.
            matched.append(place_at_scale(part, rough.scale, [rough.places] if rough.scale < 1 else []))
    best = max(matched, key=lambda one: one[1][0].certainty)
    if len(parts) > 1 or max(certainty, best[1][0].certainty) >= UNKNOWN_SCALE.likely:
        return best
    for step, scale in enumerate(UNKNOWN_SCALE.small_scales):
        with portion(0.55 + 0.15 * step, 0.7 + 0.15 * step):
            other = place_at_scale(part, scale)
        best = max(best, other, key=lambda one: one[1][0].certainty)
    return best


def _scale_in_files(pair: Pair, part: int) -> float:
    """The scale of the source (0) or target (1), with the other shape at unit area, in the units of their files."""
    lengths = [
        shape.proxy.full.scale * float(np.sqrt(shape.basis.areas.sum()))
        for shape in (pair.source_shape, pair.target_shape)
    ]
    return lengths[part] / lengths[1 - part]


def _is_other_unit(scale: float, known: float | None) -> bool:
    """Whether a scale is in another unit than a known one, if any, that has been tried."""
    return known is None or abs(np.log(scale / known)) > np.log(UNKNOWN_SCALE.one_unit)


def _scales_to_try(known: float | None) -> list[float]:
    """Scales of a part, or large ones of one of two fragments, whose scale in the units of their files is known."""
    min_scale = 0.0 if known is None else UNKNOWN_SCALE.of_fragments
    return [each for each in UNKNOWN_SCALE.scales if each >= min_scale and _is_other_unit(each, known)]


@dataclass(frozen=True, eq=False)
class RoughPlace:
    """A part's rough place on a whole of unit area."""

    certainty: float  # probability that it is right
    scale: float  # of the part, at which it fits best there
    places: Integers  # (d_p,) the whole's place for each place of the part
    fit: float  # of the part there, the lower the better


def rough_places(part: ShapeAnalysis, whole: ShapeAnalysis, scales: Sequence[float]) -> list[RoughPlace]:
    """Places of a part of unit area on a whole of unit area, the most certain first, searched for at some scales.

    The scales do not compete at first, because every map seems better in a smaller unit. Scales with the most certain
    maps are fitted to these maps, and compared once the part is finely registered.
    """
    if not scales:
        return []
    there, sets = IncompleteShape(whole), landmark_sets(_incomplete(part, scales[0]), UNKNOWN_SCALE.regions)
    _ = there.unaffected  # computed once, before several threads need it

    def place_at(scale: float) -> RoughPlace:
        region = Region.everywhere(_incomplete(part, scale), there)
        first = rough_candidates([region], sets, UNKNOWN_SCALE.maps_per_scale)[0]
        return RoughPlace(certainty_of_fit(first.scores), scale * stretch(first), first.places, first.scores["fit"])

    def fit_scale(rough: RoughPlace) -> RoughPlace:
        region = Region.everywhere(_incomplete(part, rough.scale), there)
        fine = register_places(rough.places, region)
        scale = rough.scale * stretch(fine)
        return RoughPlace(certainty_of_fit(fine.scores), scale, fine.places, fine.scores["fit"])

    with portion(0.0, 0.8):
        found = sorted(for_each(place_at, scales), key=lambda rough: rough.certainty, reverse=True)
    with portion(0.8, 1.0):
        fitted = for_each(fit_scale, found[: UNKNOWN_SCALE.compared])
    return sorted(fitted, key=lambda rough: rough.certainty, reverse=True)


def nearly_best(places: Sequence[RoughPlace]) -> list[RoughPlace]:
    """The first of places by certainty, and those at another scale that are nearly as certain."""
    best, *others = places
    tried = [best]
    for one in others:
        apart = min(abs(np.log(one.scale / other.scale)) for other in tried)
        if one.certainty >= UNKNOWN_SCALE.nearly * best.certainty and apart > np.log(UNKNOWN_SCALE.another_scale):
            tried.append(one)
    return tried


def _incomplete(part: ShapeAnalysis, scale: float) -> IncompleteShape:
    """A part at a scale, as a shape that may lack pieces."""
    return IncompleteShape(at_scale(part, scale))


def stretch(candidate: PartCandidate) -> float:
    """The median ratio of the distances between images to those between their places that no cut has changed."""
    part, whole = candidate.region.part, candidate.region.whole
    among = whole.between[np.ix_(candidate.places, candidate.places)]
    tells = part.unaffected & (part.between > UNKNOWN_SCALE.far)
    return float(np.median(among[tells] / part.between[tells])) if tells.any() else 1.0


def unit_fits(candidates: Sequence[Candidate]) -> bool:
    """Whether the first map of a part in the given unit is likely, and keeps lengths: then this unit is right.

    In another unit, a part is stretched or shrunk where it is registered.
    """
    if not candidates or candidates[0].certainty < UNKNOWN_SCALE.likely:
        return False
    first = candidates[0].part_match
    return first is not None and abs(np.log(stretch(first))) < np.log(UNKNOWN_SCALE.right_unit)


def times_as_large(pair: Pair) -> float:
    """The factor by which a pair in one unit scales the target's vertices, relative to the source's."""
    return pair.source_shape.proxy.full.scale / pair.target_shape.proxy.full.scale
