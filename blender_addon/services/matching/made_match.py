# SPDX-License-Identifier: GPL-3.0-or-later
"""The match that a transfer, a wrap or a dress follows: the stored one, or a new one, unless that is probably wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import bpy
from bpy.types import Context, Mesh

import zoomout_core as zo
from zoomout_core.matching.report.verdict import RefusedMatchError
from zoomout_core.runtime.progress import portion

from ...mesh_data import ObjectPair
from ...scene.pair import find_mesh, writing
from ...storage import stored_match
from ...storage.stored_match import Match
from ...translations import translated
from .cached_results import cache_made_match, last_made_match
from .candidates import store_match
from .pair_match import match_pair, settings_to_store

# How a script uses a match anyway; other callers give their own sentence.
CALL_WITH_FORCE = "To use this match anyway, call the function with force=True."


@dataclass(frozen=True)
class MatchUse:
    """How an operation uses a match.

    Attributes:
        adjusted: whether it repeats the last operation with other settings, and may reuse its undone match.
        force: whether to use a new match that is probably wrong; otherwise only the match is stored.
        remedy: a sentence for the refusal of such a match: how to use it anyway.
        undo_step: whether to push an undo step with a new match, so that undoing the operation keeps it.
    """

    adjusted: bool = False
    force: bool = False
    remedy: str = CALL_WITH_FORCE
    undo_step: bool = False


BY_SCRIPT = MatchUse()


@dataclass(frozen=True, eq=False)
class FoundMatch:
    """The match of two objects that an operation follows.

    Attributes:
        match: the match.
        settings: the known options that it was made with.
        done: the fraction of the operation's progress that finding it took, in [0, 1].
        is_new: whether it was not stored before.
        refused: the match, if it is new and probably wrong, and its use is not forced.
    """

    match: Match
    settings: Mapping[str, Any]
    done: float
    is_new: bool
    refused: zo.MatchResult | None = None

    def store(self, mesh: Mesh, pair: ObjectPair) -> None:
        """Store the match on the target's mesh if it is new."""
        if self.is_new:
            store_match(mesh, self.match, pair, self.settings)


async def find_match(
    context: Context, pair: ObjectPair, share: float, use: MatchUse, match_options: dict[str, Any]
) -> FoundMatch:
    """Read the stored match of two objects; without one, match them and cache the match in memory.

    Args:
        context: Blender's.
        pair: the two objects.
        share: the fraction of the caller's progress for a new match.
        use: how the caller uses the match.
        match_options: options of `match_objects`.
    """
    stored = stored_match.read(find_mesh(context, pair.target_name).data, pair)
    if stored is not None:
        return FoundMatch(stored, stored.settings, 0.0, is_new=False)
    settings = settings_to_store(context, pair, match_options)
    with portion(0, share):
        match = (last_made_match(pair) if use.adjusted else None) or await match_pair(context, pair, **match_options)
    cache_made_match(pair, match)
    refused = None
    if isinstance(match, zo.MatchResult) and match.verdict.is_wrong and not use.adjusted and not use.force:
        refused = match
    return FoundMatch(match, settings, share, True, refused)


def store_and_stop(
    context: Context,
    pair: ObjectPair,
    match: zo.MatchResult,
    settings: Mapping[str, Any],
    use: MatchUse,
) -> NoReturn:
    """Only store a match that is probably wrong, so that the user can check it.

    Args:
        context: Blender's.
        pair: the matched objects.
        match: the match.
        settings: the options that it was made with.
        use: the sentence that says how to use the match anyway, and whether to push an undo step.

    Raises:
        RefusedMatchError: always; the message says how to continue.
    """
    with writing(context, pair) as (_, target):
        store_match(target.data, match, pair, settings)
    if use.undo_step:
        push_match()
    raise RefusedMatchError(
        "{reason} {advice} '{target}' was matched but not changed. {remedy}",
        reason=match.verdict.sentence,
        advice=match.verdict.advice,
        target=pair.target_name,
        remedy=use.remedy,
    )


def push_match() -> None:
    """Push an undo step with the new match."""
    bpy.ops.ed.undo_push(message=translated("Match"))
