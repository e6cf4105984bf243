# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of matches that are kept in memory, for choosing another candidate or adjusting a transfer."""

from __future__ import annotations

from collections import OrderedDict

import zoomout_core as zo

from ...mesh_data import ObjectPair
from ...storage import stored_candidates, stored_match
from ...storage.stored_candidates import CandidateList

# Number of matches whose results are cached, the most recently used ones.
MAX_CACHED = 2
# Likewise of matches that transfers made, possibly for several targets at once.
MAX_MADE = 8

# Computed results, by the list's key and the candidate's number.
_cache: OrderedDict[str, dict[int, zo.MatchResult]] = OrderedDict()
# The latest matches that transfers made, by the fingerprints of their objects.
_made: OrderedDict[tuple[str, ...], stored_match.Match] = OrderedDict()


def cache_result(key: str, result: zo.MatchResult) -> None:
    """Cache a result in memory, beside those of other candidates in the same list."""
    _cache.setdefault(key, {})[result.chosen] = result
    _cache.move_to_end(key)
    while len(_cache) > MAX_CACHED:
        _cache.popitem(last=False)


def cache_made_match(pair: ObjectPair, match: stored_match.Match) -> None:
    """Cache a match that a transfer made, so that the transfer can be adjusted."""
    _made[_digests(pair)] = match
    while len(_made) > MAX_MADE:
        _made.popitem(last=False)


def last_made_match(pair: ObjectPair) -> stored_match.Match | None:
    """The cached match that a transfer made of these two objects in their present state, or None."""
    return _made.get(_digests(pair))


def _digests(pair: ObjectPair) -> tuple[str, ...]:
    return tuple(one.digest for one in (*pair.source_fingerprints, pair.target_fingerprint))


def clear() -> None:
    """Remove all results from memory."""
    _cache.clear()
    _made.clear()
    stored_candidates.parse.cache_clear()


def is_cached(listing: CandidateList) -> bool:
    """Whether the results of a list's candidates are available without matching again."""
    return listing.key in _cache


def of_list(listing: CandidateList) -> dict[int, zo.MatchResult]:
    """The cached results of a list, see `is_cached`, by the numbers of their candidates."""
    return _cache[listing.key]
