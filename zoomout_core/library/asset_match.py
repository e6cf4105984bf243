# SPDX-License-Identifier: GPL-3.0-or-later
"""The match of a target's body with one of an asset, and the misfit by which assets are ranked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from zoomout_core.library.bodies import Body, match_options
from zoomout_core.library.descriptor import compare
from zoomout_core.library.found import FoundSource
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.ranking.scores import SCORES
from zoomout_core.matching.result import MatchResult


def match_asset(path: Path, source: Body, target: Body) -> FoundSource:
    """Match a body of an asset with one of the target, which should be of the same kind."""
    result = match(source.surface, target.surface, match_options())
    difference = compare(source.descriptor, target.descriptor).total
    return FoundSource(path, difference, result.certainty, misfit_of(result), result)


def misfit_of(result: MatchResult) -> float:
    """The weighted geometric mean of the errors that rank the candidates of a match."""
    weights = (
        SCORES.place + SCORES.facing + SCORES.commutativity + SCORES.frequency + SCORES.distance + SCORES.curvature
    )
    return float(np.exp(result.candidates[result.chosen].scores["total"] / weights))
