"""What tells a candidate from the most likely one: what it exchanges, turns round, or has elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.tuning import Tuning, tuned

BEST, MIRROR, SIDES, FRONT, AROUND, UPSIDE_DOWN = "BEST", "MIRROR", "SIDES", "FRONT", "AROUND", "UPSIDE_DOWN"
ARMS, LEGS, LIMBS, TOP, BOTTOM = "ARMS", "LEGS", "LIMBS", "TOP", "BOTTOM"


@dataclass(frozen=True)
class DifferenceTuning(Tuning, set_by="judgement"):
    """When maps differ, and in what; lengths are over the diagonal of the first map's images.

    Attributes:
        as_a_whole: part of what a turn moves that has to follow it where one map is another, reflected or turned.
        different: distance between images beyond which they differ.
        same_place: mean distance between limbs that are exchanged.
        upright: height over width from which a shape stands upright: a person with arms stretched out, and no dog.
        told: part of what differs that lies above, or below, the middle from which on it is told.
    """

    as_a_whole: float = tuned(0.75, "1", 0, 1)
    different: float = tuned(0.1, "1", 0, 1)
    same_place: float = tuned(0.05, "1", 0, 1)
    upright: float = tuned(0.8, "1", 0, 100)
    told: float = tuned(0.25, "1", 0, 0.5)


DIFFERENCES = DifferenceTuning()


def differences(images: Sequence[Floats], mirrored: Sequence[bool]) -> list[str]:
    """How each map differs from the first one, which is the `BEST`.

    Args:
        images: for each map (s, 3) the points of the source that the same places of the target go to; Z is up.
        mirrored: whether each reverses the orientation.
    """
    return [BEST, *(_difference(images[0], *one) for one in zip(images[1:], mirrored[1:], strict=True))]


def _difference(here: Floats, there: Floats, mirrored: bool) -> str:
    if mirrored:
        return MIRROR
    low, extent = here.min(axis=0), np.ptp(here, axis=0)
    center, diagonal = low + extent / 2, float(np.linalg.norm(extent))
    signs = _turned(here - center, there - center, DIFFERENCES.different * diagonal)
    if signs is not None:
        return _of_whole(signs, here, center)
    apart = np.linalg.norm(there - here, axis=1)
    differs = apart > DIFFERENCES.different * diagonal
    above = (here[:, 2] - center[2]) > 0
    if differs.any() and np.mean(cKDTree(here[differs]).query(there[differs])[0]) < DIFFERENCES.same_place * diagonal:
        return _of_limbs(float(above[differs].mean()), extent[2] > DIFFERENCES.upright * extent[:2].max())
    return TOP if np.average(above, weights=apart + 1e-9) > 0.5 else BOTTOM


def _turned(here: Floats, there: Floats, moved: float) -> Floats | None:
    """Which axes have to be reversed (3,), -1 or 1, to make one map of another, or None where that does not do it.

    Of what a turn moves by more than a length, nearly all has to be nearer to where it takes it than to where it was.
    """
    best, most = None, DIFFERENCES.as_a_whole
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
    # The sides lie along that of both level axes along which the shape is most like its own reflection.
    tree = cKDTree(here)
    unlike = [float(np.mean(tree.query(2 * center * axis + here * (1 - 2 * axis))[0])) for axis in np.eye(3)[:2]]
    return SIDES if signs[int(np.argmin(unlike))] < 0 else FRONT


def _of_limbs(above: float, upright: bool) -> str:
    """What is exchanged, by the part of it that lies above the middle."""
    if not upright:
        return LEGS if above < 0.5 else LIMBS
    if above > 1 - DIFFERENCES.told:
        return ARMS
    return LEGS if above < DIFFERENCES.told else LIMBS
