# SPDX-License-Identifier: GPL-3.0-or-later
"""Analyse the shapes of a match before it is started, so that it only has to compare them."""

from __future__ import annotations

from functools import partial
from typing import Any

from bpy.types import Context

import zoomout_core as zo
from zoomout_core.matching.pipeline import prepare
from zoomout_core.matching.presets import resolve_detail

from ...jobs import compute
from ...scene.pair import read_pair


async def prepare_ahead(
    context: Context, source_name: str, target_name: str, detail: str = "balanced", k_final: int = 0, **_: Any
) -> None:
    """Analyse the shapes of `match_objects` with these arguments in one thread; nothing is written.

    Raises:
        MeshError: an object cannot be used.
    """
    pair = await read_pair(context, source_name, target_name)
    options = zo.MatchOptions(**resolve_detail(detail, k_final))
    await compute(partial(prepare, pair.source, pair.target, options))
