"""Bend the match that is stored on a target, near landmarks that it misses, without matching again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.bend import bent
from zoomout_core.matching.constraints import CONSTRAINTS
from zoomout_core.runtime.stepping import Steps, drain, spread
from zoomout_core.runtime.threads import in_background
from zoomout_core.tuning import Tuning, tuned

from ..mesh_data import ObjectPair
from ..scene.landmarks import LandmarkPairs, landmark_pairs, landmarks_fingerprint, landmarks_in_words
from ..scene.pair import check_unedited, find_mesh
from ..scene.stored_pair import read_stored_match_steps
from ..storage import stored_match
from ..storage.stored_match import StoredMatch
from ..viewport import preview
from . import previews


@dataclass(frozen=True)
class BendTuning(Tuning, set_by="judgement"):
    """How far a match is bent.

    Attributes:
        most: by which the match may miss a landmark; beyond, it is another place, to be found by matching.
        width: least width of what is bent, over the largest miss; from 0.86 on a Gaussian turns nothing over.
    """

    most: float = tuned(0.2, "at unit area", 0, 2)
    width: float = tuned(1.5, "1", 0.86, 10)


BEND = BendTuning()


def bend_match(context: Context, target: Object) -> str:
    """Bend the match stored on a target so that it meets the landmarks that it and its source have.

    Args:
        context: Blender's; the target and its source are in its scene.
        target: was matched; in Object Mode.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no match as the two are now, no landmark on both, or the match misses one by so much that
            only matching again can find the place; nothing was changed.
    """
    return drain(bend_match_steps(context, target.name))


def bend_match_steps(context: Context, target_name: str) -> Steps[str]:
    """`bend_match` as a generator, which holds no Blender data while it is suspended."""
    pair, match = yield from read_stored_match_steps(context, target_name)
    landmarks = landmark_pairs(context, find_mesh(context, pair.source_name), find_mesh(context, target_name))
    if not landmarks.numbers:
        raise zo.MeshError(f"'{pair.source_name}' and '{target_name}' have no landmark in common: place one on both.")
    surface_map, most = yield from spread(
        in_background(partial(_bent, pair, match, landmarks)), 0, 1, "Bending the match"
    )
    count = len(landmarks.numbers)
    what = landmarks_in_words(count)
    note = f"Bent to {what}."
    notes = (note, *(other for other in match.notes if not other.startswith("Bent to ")))
    result = replace(match, surface_map=surface_map, notes=notes)
    following = yield from previews.following_steps(context, pair, result)
    source, target = check_unedited(context, pair)
    seen = {stored_match.LANDMARKS: landmarks_fingerprint(context.scene, source, target)}
    stored_match.write(target.data, result, pair, match.settings | seen)
    if following is not None:
        preview.show(following)
    return f"Bent the match of '{target_name}' to {what}, which it missed by up to {most:.1%} of its size"


def _bent(pair: ObjectPair, match: StoredMatch, landmarks: LandmarkPairs) -> tuple[zo.SurfaceMap, float]:
    """The bent map, and by how much it missed, at unit area."""
    source, target = pair.source, pair.target
    triangle, barycentric = closest_points(landmarks.target, target.vertices, target.triangles)
    corners = target.triangles[triangle]
    images = match.surface_map.interpolate(source.vertices)[corners]
    missed = landmarks.source - np.einsum("lc,lcx->lx", barycentric, images)
    size = np.sqrt(source.area)
    off = np.linalg.norm(missed, axis=1) / size
    _check_near(off, landmarks)
    # Lengths of the target, on which the bend fades, are as many times longer as it is larger.
    width = max(CONSTRAINTS.pinning_width, BEND.width * off.max()) * np.sqrt(target.area)
    places = corners[np.arange(len(corners)), barycentric.argmax(axis=1)]
    _, first = np.unique(places, return_index=True)  # two at one vertex could not both be met
    made = bent(
        match.surface_map, source.vertices, target.vertices, target.triangles, places[first], missed[first], width
    )
    return made, float(off.max())


def _check_near(off: Floats, landmarks: LandmarkPairs) -> None:
    if off.max() > BEND.most:
        number = landmarks.numbers[int(off.argmax())]
        raise zo.MeshError(f"The match is too far off landmark {number} to be bent there: match again.")
