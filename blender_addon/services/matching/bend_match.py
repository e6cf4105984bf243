# SPDX-License-Identifier: GPL-3.0-or-later
"""Bend the match stored on a target, near landmarks that it misses, without matching again."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from bpy.types import Context

import zoomout_core as zo
from zoomout_core.matching.constraints import bend_to_points, landmark_errors
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage

from ...jobs import compute
from ...mesh_data import ObjectPair
from ...scene.landmarks import LandmarkPairs, landmark_pairs, landmarks_fingerprint, landmarks_in_words
from ...scene.pair import find_mesh, writing
from ...scene.stored_pair import read_stored_match
from ...storage import stored_match
from ...storage.stored_match import StoredMatch
from ...viewport import preview
from . import previews

# Maximum distance between the match and a landmark, at unit area; beyond, the place has to be found by matching.
MAX_MISS = 0.2


async def bend_match_async(context: Context, target_name: str) -> str:
    """Bend the match stored on a target so that it meets the landmarks that both objects have.

    Args:
        context: Blender's; the target and its source are in its scene.
        target_name: name of a matched object, in Object Mode. No Blender data is kept across an `await`.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no valid match, no landmark on both, or the match is too far from one to be bent, so that
            they have to be matched again; nothing was changed.
    """
    pair, match = await read_stored_match(context, target_name)
    landmarks = landmark_pairs(context, find_mesh(context, pair.source_name), find_mesh(context, target_name))
    if not landmarks.numbers:
        raise zo.MeshError(
            "'{source}' and '{target}' have no landmark in common: place one on both.",
            source=pair.source_name,
            target=target_name,
        )
    with stage("Bending the match"):
        surface_map, most = await compute(partial(_bend, pair, match, landmarks))
    count = len(landmarks.numbers)
    what = landmarks_in_words(count)
    note = message("Bent to {landmarks}.", landmarks=what)
    notes = (note, *(other for other in match.notes if not other.startswith("Bent to ")))
    result = replace(match, surface_map=surface_map, notes=notes)
    following = await previews.updated_preview(context, pair, result)
    with writing(context, pair) as (source, target):
        seen = {stored_match.LANDMARKS: landmarks_fingerprint(context.scene, source, target)}
        stored_match.write(target.data, result, pair, match.settings | seen)
    if following is not None:
        preview.show(following)
    return message(
        "Bent the match of '{target}' to {landmarks}, which it missed by up to {most:.1%} of its size",
        target=target_name,
        landmarks=what,
        most=most,
    )


def _bend(pair: ObjectPair, match: StoredMatch, landmarks: LandmarkPairs) -> tuple[zo.SurfaceMap, float]:
    """The bent map, and its largest distance to a landmark before, at unit area."""
    given = match.surface_map, pair.source, pair.target, landmarks.source, landmarks.target
    off = landmark_errors(*given)
    if off.max() > MAX_MISS:
        number = landmarks.numbers[int(off.argmax())]
        raise zo.MeshError("The match is too far from landmark {number} to be bent to it: match again.", number=number)
    return bend_to_points(*given), float(off.max())
