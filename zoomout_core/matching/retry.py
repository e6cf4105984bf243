# SPDX-License-Identifier: GPL-3.0-or-later
"""Second attempts if the first one is uncertain: match one shape as a part of the other, or add more hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zoomout_core.matching.attempt import Attempt, agree, confirm
from zoomout_core.matching.constraints import Constraints
from zoomout_core.matching.hypotheses.collect import gather_evidence, more_hypotheses
from zoomout_core.matching.hypotheses.given import given_hypothesis
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.part_match import (
    PART_MATCH,
    are_fragments,
    in_one_unit,
    match_part,
    may_be_part,
    part_of,
    places_of,
    sizes_differ,
    units_differ,
)
from zoomout_core.matching.partial.region import REGION, is_small
from zoomout_core.matching.partial.unknown_scale import (
    UNKNOWN_SCALE,
    match_at_unknown_scale,
    times_as_large,
    unit_fits,
)
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import CERTAINTY, certainty_but_for_turns, certainty_of_fit
from zoomout_core.matching.ranking.finished_maps import rank_finished
from zoomout_core.matching.ranking.rank import rank, with_others
from zoomout_core.matching.ranking.rotational_symmetry import with_turned
from zoomout_core.matching.report.notes import OTHER_UNITS, RESCALED
from zoomout_core.messages import message, warning
from zoomout_core.runtime.progress import portion, stage


def needs_retry(first: Attempt, options: MatchOptions) -> bool:
    """Whether an attempt is uncertain, and options let another one be made."""
    if options.initial not in ("auto", "landmarks"):
        return False
    return certainty_but_for_turns(first.candidates) < PART_MATCH.uncertain or sizes_differ(first.pair)


def retry(first: Attempt, known: Constraints, options: MatchOptions) -> Attempt:
    """Match one shape as a part of the other, or add more hypotheses; returns the more certain attempt."""
    fragments = False
    if options.partial == "auto" and may_be_part(first.pair):
        with portion(0.0, 0.7):
            second = attempt_part(first, known)
        if second is not first:
            return second
        if units_differ(first.pair):
            first = replace(first, pair=_with_note(first.pair, warning(OTHER_UNITS)))
        fragments = are_fragments(first.pair)
    # More hypotheses found none of eight maps of fragments that were not found as parts.
    if options.initial == "auto" and not fragments and certainty_but_for_turns(first.candidates) < CERTAINTY.unlikely:
        with portion(0.7, 1.0):
            return _with_more_guesses(first, known, options)
    return first


def attempt_part(whole: Attempt, known: Constraints) -> Attempt:
    """Match one shape as a part of the other; returns the given attempt unless the part match is more certain.

    The units of the files are tried first, unless they are known to differ. Other scales follow unless the part fits.
    Two fragments are matched as parts even if no map is likely, unless their map as wholes is certain.
    """
    fragments = are_fragments(whole.pair)
    upright = known.upright and fragments
    known = replace(known, upright=False)  # a limb may point anywhere
    best = fallback = whole  # the fallback is returned if no map in another unit is likely
    if not units_differ(whole.pair):
        pair = in_one_unit(whole.pair)
        with stage("Placing a part", 0.0, 0.3):
            given = [places_of(one, pair) for one in _maps_of_fragments(whole)]
            candidates = match_part(pair, known.disagreement(pair), given, upright)
        best = fallback = _as_part(whole, pair, candidates, PART_MATCH.likely)
        if unit_fits(candidates) or (fragments and best is not whole):
            return best
        if fragments and whole.candidates[0].certainty < UNKNOWN_SCALE.certain:
            # A map of fragments as wholes has a partner for nearly all of their area. It competes as a part, too.
            fallback = _as_part(whole, pair, candidates, likely=0.0)
            # Rivals in the same unit do not indicate another one.
            if candidates and certainty_of_fit(candidates[0].scores) >= PART_MATCH.likely:
                return fallback
    certainty = best.candidates[0].certainty
    if certainty >= (UNKNOWN_SCALE.certain if best is whole else UNKNOWN_SCALE.enough):
        return best
    with stage("Finding the scale of a part", 0.3, 1.0):
        found = match_at_unknown_scale(whole.pair, known.disagreement, certainty)
    if found is None:
        return fallback
    pair, candidates = found
    times, likely = times_as_large(pair), PART_MATCH.likely
    if abs(np.log(times)) > np.log(UNKNOWN_SCALE.one_unit):
        pair, likely = _with_note(pair, message(RESCALED, times=times)), UNKNOWN_SCALE.likely
    rescaled = _as_part(whole, pair, candidates, likely)
    keep_unit = best is not whole and best.candidates[0].certainty >= rescaled.candidates[0].certainty
    return fallback if keep_unit or rescaled is whole else rescaled


def _maps_of_fragments(whole: Attempt) -> Sequence[Candidate]:
    """Maps of a pair as wholes that may also be maps of two fragments."""
    if not are_fragments(whole.pair):
        return ()
    return [one for one in whole.candidates if not one.reverses_orientation][: PART_MATCH.as_wholes]


def _as_part(whole: Attempt, pair: Pair, candidates: Sequence[Candidate], likely: float) -> Attempt:
    """Choose between a match of two whole shapes and one of a part, by certainty.

    The candidates are those of the pair in one unit; below the certainty `likely` no shape is taken for a part.
    """
    between_fragments = are_fragments(whole.pair)
    # The certainty of the map of two wholes knows nothing of their sizes; that of two fragments competes as a part.
    weight = 0.0 if between_fragments else REGION.as_wholes if is_small(*part_of(pair)) else 1.0
    of_whole = weight * certainty_but_for_turns(whole.candidates)
    if not candidates or candidates[0].certainty <= max(likely, of_whole):
        return whole
    part = Attempt(pair, candidates, whole.coverage)
    areas = [shape.basis.areas.sum() for shape in (pair.source_shape, pair.target_shape)]
    nearly_whole = min(areas) >= PART_MATCH.nearly_whole * max(areas)
    if nearly_whole and not between_fragments and agree(whole, part):
        return confirm(whole, part)
    return part


def _with_more_guesses(attempt: Attempt, known: Constraints, options: MatchOptions) -> Attempt:
    """An attempt with the candidates of more hypotheses beside its own."""
    pair = attempt.pair
    shapes = pair.source_shape, pair.target_shape
    earlier = None if options.initial_map is None else given_hypothesis(pair, options.initial_map)
    evidence = gather_evidence(pair, known, earlier)
    disagreement = evidence.disagreement(pair)
    with stage("Searching again", 0.0, 0.3):
        hypotheses = more_hypotheses(pair, evidence, disagreement)
    with stage("Comparing candidates", 0.3, 0.8):
        found = rank(hypotheses, *shapes, disagreement)
    with stage("Comparing finished maps", 0.8, 1.0):
        candidates = rank_finished(with_others(attempt.candidates, found, *shapes), *shapes, pair.step)
    return replace(attempt, candidates=with_turned(candidates, *shapes, disagreement))


def _with_note(pair: Pair, note: str) -> Pair:
    return replace(pair, notes=(*pair.notes, note))
