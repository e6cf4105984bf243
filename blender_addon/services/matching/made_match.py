# SPDX-License-Identifier: GPL-3.0-or-later
"""The match that a transfer, a wrap or a dress makes if none is stored, and the stop if it is probably wrong."""

from __future__ import annotations

from typing import Any, NoReturn, TypeGuard

import bpy
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.matching.report.verdict import RED, RefusedMatchError

from ...mesh_data import ObjectPair
from ...scene.pair import writing
from ...storage.stored_match import Match
from ...translations import translated
from ..constraints import match_pair, settings_to_store
from .candidates import cache_made_match, last_made_match, store_match

# How a script uses a match anyway; other callers give a sentence of their own.
CALL_WITH_FORCE = "To use this match anyway, call the function with force=True."


async def make_match(
    context: Context, pair: ObjectPair, adjusted: bool, match_options: dict[str, Any]
) -> tuple[Match, dict[str, Any]]:
    """Match two objects, and cache the match in memory; returns it with the settings to store.

    Args:
        context: Blender's.
        pair: the two objects.
        adjusted: whether the caller repeats its last operation with other settings, and may reuse the cached match.
        match_options: options of `match_objects`.
    """
    settings = settings_to_store(context, pair, match_options)
    made = last_made_match(pair) if adjusted else None
    match = made or await match_pair(context, pair, **match_options)
    cache_made_match(pair, match)
    return match, settings


def is_probably_wrong(match: Match) -> TypeGuard[zo.MatchResult]:
    """Whether the verdict on a match is red."""
    return isinstance(match, zo.MatchResult) and match.verdict.level == RED


def store_and_stop(
    context: Context,
    pair: ObjectPair,
    match: zo.MatchResult,
    settings: dict[str, Any],
    remedy: str,
    undo_step: bool = False,
) -> NoReturn:
    """Store a match that is probably wrong, so that the user can look at it, and do nothing else.

    Args:
        context: Blender's.
        pair: the matched objects.
        match: the match.
        settings: the options that it was made with.
        remedy: a sentence that says how to use the match anyway.
        undo_step: whether to push an undo step.

    Raises:
        RefusedMatchError: always; the message says how to go on.
    """
    with writing(context, pair) as (_, target):
        store_match(target.data, match, pair, settings)
    if undo_step:
        push_match()
    raise RefusedMatchError(
        "{reason} {advice} '{target}' was matched but not changed. {remedy}",
        reason=match.verdict.sentence,
        advice=match.verdict.advice,
        target=pair.target_name,
        remedy=remedy,
    )


def push_match() -> None:
    """Push an undo step with the new match."""
    bpy.ops.ed.undo_push(message=translated("Match"))
