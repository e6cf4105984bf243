# SPDX-License-Identifier: GPL-3.0-or-later
"""The candidates of a match: the list of them, and their full results, which are cached in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Mesh

import zoomout_core as zo
from zoomout_core.arrays import Bytes, Floats
from zoomout_core.colors import DARK, LIGHT, place_colors
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.candidate_differences import differences
from zoomout_core.symmetry.detect import MIN_SYMMETRY_CERTAINTY

from ...jobs import compute
from ...mesh_data import ObjectPair
from ...mesh_data.arrays import hash_of
from ...storage import stored_candidates, stored_match
from ...storage.stored_candidates import CandidateList, ListedCandidate
from . import cached_results

# Maximum number of listed candidates that preserve orientation, and of those that reverse it, which rank below.
MAX_DIRECT, MAX_MIRRORED = 6, 2


def store_match(mesh: Mesh, match: stored_match.Match, pair: ObjectPair, settings: Mapping[str, Any]) -> None:
    """Store a match on the target's mesh with a list of its candidates, and cache its result.

    Args:
        mesh: the target's mesh.
        match: the match.
        pair: its two objects.
        settings: arguments that it was computed with, see `stored_match.write`.
    """
    stored_match.write(mesh, match, pair, settings)
    if isinstance(match, zo.MatchResult) and len(match.candidates) > 1:
        listing = list_candidates(match, pair)
        cached_results.cache_result(listing.key, match)
        stored_candidates.write(mesh, listing)
    else:
        stored_candidates.remove(mesh)


def list_candidates(result: zo.MatchResult, pair: ObjectPair) -> CandidateList:
    """The candidates of a result that a user may choose from, including the one in use.

    These are the most probable one, others above a minimum certainty, mirror images, and for each probable one the
    candidate that swaps its sides, whatever its probability.
    """
    outlines = [result.outline(number) for number in range(len(result.candidates))]
    vertices = outlines[0][0]
    around = pair.source.vertices
    box = np.array([np.nanmin(around, axis=0), np.nanmax(around, axis=0)])
    colors = [np.rint(255 * place_colors(around[images], box)).astype(np.uint8) for _, images in outlines]
    numbers = sorted({*_selectable(result.candidates, colors), result.chosen})
    mirrored = [result.candidates[number].reverses_orientation for number in numbers]
    named = differences([around[outlines[number][1]] for number in numbers], mirrored)
    return CandidateList(
        hash_of("", vertices, *(colors[number] for number in numbers)),
        numbers.index(result.chosen),
        vertices,
        pair.target.vertices[vertices],
        np.nan_to_num(np.ptp(around[np.isfinite(around).all(axis=1)], axis=0)),
        tuple(
            ListedCandidate(
                number,
                result.candidates[number].certainty * result.placed,
                reverses,
                colors[number],
                difference,
            )
            for number, reverses, difference in zip(numbers, mirrored, named, strict=True)
        ),
    )


async def result_of(listing: CandidateList, place: int) -> zo.MatchResult:
    """The full result of the candidate at an index of a cached list, see `cached_results.is_cached`."""
    number, cached = listing.candidates[place].number, cached_results.of_list(listing)
    if number not in cached:
        result = await compute(partial(next(iter(cached.values())).use, number))
        cached_results.cache_result(listing.key, result)
    return cached_results.of_list(listing)[number]


def side_swapped_candidate(listing: CandidateList) -> int | None:
    """Index of the candidate that most nearly swaps the sides of the one in use, or None if none does."""
    return _side_swapped_number(listing.chosen, [candidate.colors for candidate in listing.candidates])


def most_similar(place: int, listing: CandidateList, found: CandidateList) -> int:
    """Index in a new list of the candidate that is most similar to one of an old list of the same objects."""
    wanted = listing.candidates[place].colors.astype(float)
    nearest = np.linalg.norm(found.points[:, None] - listing.points[None], axis=2).argmin(axis=1)
    return int(np.argmin([np.abs(wanted[nearest] - other.colors).mean() for other in found.candidates]))


def _selectable(found: Sequence[Candidate], colors: Sequence[Bytes]) -> set[int]:
    """Numbers of the candidates to list besides the one in use, from all candidates and their colours."""
    order = range(len(found))
    direct = [number for number in order if not found[number].reverses_orientation]
    least = MIN_SYMMETRY_CERTAINTY
    likely = [one for one in direct if one == direct[0] or found[one].certainty >= least][:MAX_DIRECT]
    mirrored = [number for number in order if found[number].reverses_orientation][:MAX_MIRRORED]
    swapped = (_side_swapped_number(number, colors) for number in likely)
    return {*likely, *mirrored, *(number for number in swapped if number is not None)}


def _side_swapped_number(chosen: int, colors: Sequence[Bytes]) -> int | None:
    """Number of the map that most nearly swaps the sides of the chosen one, by the maps' position colours.

    The sides are separated by one of the three mid-planes of the source's bounding box: the map is nearer to the
    reflection of the chosen one in such a plane than to the chosen one itself.
    """
    here = colors[chosen].astype(float)
    best, least = None, np.inf
    for number, other in enumerate(colors):
        unswapped = np.abs(other - here).mean()
        for axis in range(3):
            reflected = here.copy()
            reflected[:, axis] = _reflect(here[:, axis])
            difference = np.abs(other - reflected).mean()
            if number != chosen and difference < min(least, unswapped):
                best, least = number, difference
    return best


def _reflect(color: Floats) -> Floats:
    return 255 * (DARK + LIGHT) - color
