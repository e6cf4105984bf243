# SPDX-License-Identifier: GPL-3.0-or-later
"""Correct the match of a target by the bones of its source, see `rest_pose.correct_by_bones`."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from bpy.types import Context
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import map_target
from zoomout_core.transfer.rigging.rest_pose import correct_by_bones

from ...jobs import compute
from ...mesh_data import ObjectPair
from ...scene.pair import find_mesh
from ..binding.check import moves_vertices
from ..binding.read import read_rest
from .half_match import HalfResult


async def correct_match(context: Context, pair: ObjectPair, result: zo.MatchResult) -> zo.MatchResult:
    """Correct the map of a match by the bones of the source, if the target is its own body in another pose.

    A match that is probably wrong stays as it is. Exact landmarks are still met.
    """
    if result.verdict.is_wrong or not moves_vertices(find_mesh(context, pair.source_name)):
        return result
    try:
        rest, bones, weights = read_rest(context, pair)
    except zo.MeshError:  # its modifiers do not allow it
        return result
    with stage("Finding the pose", 1, 1):
        return await compute(partial(_correct, result, rest, weights, bones.parents))


def _correct(result: zo.MatchResult, rest: zo.Surface, weights: csr_array, parents: Integers) -> zo.MatchResult:
    if isinstance(result, HalfResult):
        return HalfResult.of(_correct(result.whole, rest, weights, parents), result.half)
    mapped = map_target(result, result.source, result.target)
    corrected = correct_by_bones(mapped, rest, weights, parents)
    if corrected is mapped:
        return result
    surface_map = result.meet_landmarks(corrected.surface_map)
    return replace(result, surface_map=surface_map, confidence=corrected.confidence)
