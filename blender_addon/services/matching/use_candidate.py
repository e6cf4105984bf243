# SPDX-License-Identifier: GPL-3.0-or-later
"""Replace the stored match by another of its candidates."""

from __future__ import annotations

from dataclasses import replace

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.messages import message
from zoomout_core.runtime.progress import portion

from ...mesh_data import ObjectPair
from ...scene.pair import find_mesh, writing
from ...scene.stored_pair import read_stored_match
from ...storage import stored_candidates, stored_match
from ...storage.stored_candidates import CandidateList
from ...viewport import preview
from . import cached_results, candidates, previews
from .bone_match import correct_match
from .pair_match import match_pair

# Fraction of the progress for matching again, if results are no longer in memory.
MATCHING = 0.7


async def use_candidate_async(context: Context, target_name: str, place: int) -> zo.MatchResult:
    """Replace the match stored on a target by another candidate.

    Args:
        context: Blender's; the target and its source are in its scene.
        target_name: name of a matched object. No Blender data is kept across an `await`.
        place: index of the candidate in the list, see `stored_candidates.read`.

    Raises:
        MeshError: there is no match, or an object was edited since; nothing was written.
    """
    target = find_mesh(context, target_name)
    listing = stored_list(target)
    note = message("Candidate {number} of {count} was chosen.", number=place + 1, count=len(listing.candidates))
    with previews.approximate_candidate(target, listing, place):
        pair, stored = await read_stored_match(context, target_name)
        result = await correct_match(context, pair, await _result(context, pair, listing, place, stored))
        result = replace(result, notes=(note, *result.notes))
        following = await previews.updated_preview(context, pair, result)
        with writing(context, pair) as (_, target):
            candidates.store_match(target.data, result, pair, stored.settings)
    if following is not None:
        preview.show(following)
    return result


async def _result(
    context: Context, pair: ObjectPair, listing: CandidateList, place: int, stored: stored_match.StoredMatch
) -> zo.MatchResult:
    """The result of a candidate; if it is not cached, the objects are matched again with the same settings."""
    if cached_results.is_cached(listing):
        return await candidates.result_of(listing, place)
    settings = stored.settings | {"initial": "auto", "from_last": False}
    settings.pop(stored_match.LANDMARKS, None)
    with portion(0, MATCHING):
        rematched = await match_pair(context, pair, **settings)
    assert isinstance(rematched, zo.MatchResult)  # an automatic start
    found = candidates.list_candidates(rematched, pair)
    cached_results.cache_result(found.key, rematched)
    alike = candidates.most_similar(place, listing, found)
    with portion(MATCHING, 1):
        return await candidates.result_of(found, alike)


def stored_list(target: Object) -> CandidateList:
    """The list of candidates stored on a target's mesh.

    Raises:
        MeshError: no list is stored.
    """
    listing = stored_candidates.read(target.data)
    if listing is None:
        raise zo.MeshError("There are no candidates for '{target}': match it first.", target=target.name)
    return listing
