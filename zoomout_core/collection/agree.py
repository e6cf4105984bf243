# SPDX-License-Identifier: GPL-3.0-or-later
"""Several targets matched with one source: the certain matches decide between candidates of the uncertain ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from zoomout_core.collection.cycles import Agreement, choose_agreeing
from zoomout_core.collection.pair_map import PairName, candidate_maps_of
from zoomout_core.collection.pairs import pairs_of_uncertain
from zoomout_core.collection.shapes import ShapeSummary, spread_from_samples, summary_of
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.result import MatchResult
from zoomout_core.messages import message
from zoomout_core.runtime.progress import advance, portion, stage

# Name of the source; names of targets are not empty.
SOURCE = ""
STAGE = "Comparing with other targets"
AGREED = (
    "A candidate other than the most likely one was chosen, because it is consistent with the maps of other targets."
)
THROUGH = (
    "No candidate was consistent with the maps of other targets, so the match was started from the map through "
    "'{name}'."
)


def agree(results: Mapping[str, MatchResult], options: MatchOptions) -> dict[str, MatchResult]:
    """Replace matches of several targets with one source, by name, by candidates that agree better with each other.

    Targets with an uncertain match are matched, with these options, with the most similar targets that have a certain
    one. Returns at once if either kind is missing.
    """
    certainty = {name: result.certainty for name, result in results.items()}
    between = pairs_of_uncertain(certainty, lambda name: results[name].pair.target_shape.basis.eigenvalues)
    if not between:
        return dict(results)
    first = next(iter(results.values())).pair
    summaries = {SOURCE: summary_of(first.source, first.source_shape, "")}
    for name, result in results.items():
        summaries[name] = summary_of(result.pair.target, result.pair.target_shape, "")
    maps = {
        PairName(SOURCE, name): candidate_maps_of(result, (summaries[SOURCE], summaries[name]))
        for name, result in results.items()
    }
    for number, pair_name in enumerate(between):
        surfaces = results[pair_name.source].pair.target, results[pair_name.target].pair.target
        start, end = (0.7 * (number + step) / len(between) for step in (0, 1))
        with stage(STAGE, start, end):
            asked = match(*surfaces, options)
        maps[pair_name] = candidate_maps_of(asked, (summaries[pair_name.source], summaries[pair_name.target]))
    with stage(STAGE):
        return _take(results, choose_agreeing(maps, summaries.__getitem__), summaries, options)


def _take(
    results: Mapping[str, MatchResult],
    agreement: Agreement,
    summaries: Mapping[str, ShapeSummary],
    options: MatchOptions,
) -> dict[str, MatchResult]:
    """Replace results by the candidate that agrees better, if there is one."""
    taken = dict(results)
    changed = [pair for pair in agreement.changed if pair.source == SOURCE]
    for number, pair in enumerate(changed):
        result, candidate = results[pair.target], agreement.candidate[pair]
        start, end = (0.7 + 0.3 * (number + step) / len(changed) for step in (0, 1))
        third = agreement.through.get(pair)
        with portion(start, end):
            if third is None:
                found, note = result.use(candidate), AGREED
            else:
                images = summaries[SOURCE].samples[agreement.maps[pair].forward[candidate]]
                given = spread_from_samples(result.pair.target, summaries[pair.target].samples, images)
                begun = replace(options, initial="given", initial_map=given)
                found, note = match(result.pair.source, result.pair.target, begun), message(THROUGH, name=third)
        taken[pair.target] = replace(found, notes=(note, *found.notes))
    advance(1.0)
    return taken
