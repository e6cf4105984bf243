# SPDX-License-Identifier: GPL-3.0-or-later
"""The match that a transfer, a wrap or a dress makes if none is stored."""

from __future__ import annotations

from typing import Any

from bpy.types import Context

from ..mesh_data import ObjectPair
from ..storage.stored_match import Match
from .candidates import cache_made_match, last_made_match
from .constraints import match_pair, settings_to_store


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
