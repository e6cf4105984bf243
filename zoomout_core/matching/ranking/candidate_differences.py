# SPDX-License-Identifier: GPL-3.0-or-later
"""Describe how a candidate differs from the most likely one: exchanged limbs, rotations, reflections."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import scipy

from zoomout_core.arrays import Floats

BEST, MIRROR, SIDES, FRONT, AROUND, UPSIDE_DOWN = "BEST", "MIRROR", "SIDES", "FRONT", "AROUND", "UPSIDE_DOWN"
ARMS, LEGS, LIMBS, TOP, BOTTOM = "ARMS", "LEGS", "LIMBS", "TOP", "BOTTOM"

# One map is a rotation or reflection of another if that explains this share of the places that it moves.
MIN_TURNED_SHARE = 0.75
# Images differ if they are farther apart than this, relative to the diagonal of the first map's images.
MIN_DIFFERENCE = 0.1
# Limbs are exchanged if their images cover the same places up to this mean distance, relative to the same diagonal.
EXCHANGE_DISTANCE = 0.05
# Smallest ratio of height to width of an upright shape: above a dog's, below that of a person with outstretched arms.
MIN_UPRIGHT_RATIO = 0.8
# The exchanged limbs of an upright shape are arms, or legs, if at most this share of them is on the other side of the
# middle.
MAX_OTHER_HALF_SHARE = 0.25


def differences(images: Sequence[Floats], mirrored: Sequence[bool]) -> list[str]:
    """How each map differs from the first one, which is the `BEST`.

    Each map is given by its images (s, 3) of the same places, with Z up, and whether it reverses the orientation.
    """
    return [BEST, *(_difference(images[0], *one) for one in zip(images[1:], mirrored[1:], strict=True))]


def _difference(here: Floats, there: Floats, mirrored: bool) -> str:
    if mirrored:
        return MIRROR
    low, extent = here.min(axis=0), np.ptp(here, axis=0)
    center, diagonal = low + extent / 2, float(np.linalg.norm(extent))
    signs = _reversed_axes(here - center, there - center, MIN_DIFFERENCE * diagonal)
    if signs is not None:
        return _of_whole(signs, here, center)
    apart = np.linalg.norm(there - here, axis=1)
    differs = apart > MIN_DIFFERENCE * diagonal
    above = (here[:, 2] - center[2]) > 0
    if (
        differs.any()
        and np.mean(scipy.spatial.cKDTree(here[differs]).query(there[differs])[0]) < EXCHANGE_DISTANCE * diagonal
    ):
        return _of_limbs(float(above[differs].mean()), extent[2] > MIN_UPRIGHT_RATIO * extent[:2].max())
    return TOP if np.average(above, weights=apart + 1e-9) > 0.5 else BOTTOM


def _reversed_axes(here: Floats, there: Floats, moved: float) -> Floats | None:
    """(3,) -1 for axes that have to be reversed to turn one map into another, else 1; None if no reversal does.

    Nearly all points that the reversal moves by more than a length have to be nearer to its goals than to its starts.
    """
    best, most = None, MIN_TURNED_SHARE
    for signs in map(np.array, product((1.0, -1.0), repeat=3)):
        if np.abs(signs.sum()) == 3:
            continue
        goals = here * signs
        counts = np.linalg.norm(goals - here, axis=1) > moved
        nearer = np.linalg.norm(there - goals, axis=1) < np.linalg.norm(there - here, axis=1)
        share = float(nearer[counts].mean()) if counts.any() else 0.0
        if share > most or (best is not None and share == most and _error(there, goals) < _error(there, here * best)):
            best, most = signs, share
    return best


def _error(there: Floats, goals: Floats) -> float:
    return float(np.linalg.norm(there - goals, axis=1).mean())


def _of_whole(signs: Floats, here: Floats, center: Floats) -> str:
    if signs[2] < 0:
        return UPSIDE_DOWN
    if signs[0] == signs[1]:
        return AROUND
    # The sides are along the horizontal axis along which the shape is most similar to its own reflection.
    tree = scipy.spatial.cKDTree(here)
    unlike = [float(np.mean(tree.query(2 * center * axis + here * (1 - 2 * axis))[0])) for axis in np.eye(3)[:2]]
    return SIDES if signs[int(np.argmin(unlike))] < 0 else FRONT


def _of_limbs(above: float, upright: bool) -> str:
    """The parts that are exchanged, in words, by the share of them above the middle."""
    if not upright:
        return LEGS if above < 0.5 else LIMBS
    if above > 1 - MAX_OTHER_HALF_SHARE:
        return ARMS
    return LEGS if above < MAX_OTHER_HALF_SHARE else LIMBS
