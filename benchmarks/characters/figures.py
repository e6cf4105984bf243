# SPDX-License-Identifier: GPL-3.0-or-later
"""Accuracy of the map of a case: shares of right bones and limbs, or distances of images from their true places."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import zoomout_core as zo
from benchmarks.characters.cases import Case
from benchmarks.characters.truth import Bones, Rest
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_points

# A case is right if this share of the target is on the right limb, or if its mean error in centimetres is smaller.
RIGHT_LIMB, RIGHT_ERROR = 0.90, 9.0
# Weights of a vertex that has any sum to one.
WEIGHTED = 0.5


class Figures(NamedTuple):
    """Figures of a map; None where the case's truth does not include them.

    Attributes:
        dom: share of the target's vertices whose strongest bone is right.
        limb: share of them on the right limb.
        side: share of the vertices on sided limbs that is mapped to the other side.
        l1: mean sum of absolute differences of the weights.
        error: mean error in centimetres.
        median: median error in centimetres.
    """

    dom: float | None = None
    limb: float | None = None
    side: float | None = None
    l1: float | None = None
    error: float | None = None
    median: float | None = None

    @property
    def right(self) -> bool:
        """Whether the map counts as right."""
        if self.error is not None:
            return self.error < RIGHT_ERROR
        return self.limb is not None and self.limb >= RIGHT_LIMB


def figures(case: Case, surface_map: zo.SurfaceMap) -> Figures:
    """The figures of a map from the target of a case to its source."""
    if isinstance(case.truth, Bones):
        return _of_bones(case.truth, surface_map)
    errors = errors_at_rest(case.truth, surface_map)
    return Figures(error=float(errors.mean()), median=float(np.median(errors)))


def nearest_in_space(case: Case) -> zo.SurfaceMap:
    """The map of Blender's Data Transfer ("Nearest Face Interpolated"), with both objects where they are."""
    source = case.source
    closest = closest_points(case.target.vertices, source.vertices, source.triangles)
    return zo.SurfaceMap(*closest, source.triangles)


def wrong(case: Case, surface_map: zo.SurfaceMap) -> Booleans:
    """(n_t,) which target vertices are mapped to a wrong limb, or too far from their true place."""
    if isinstance(case.truth, Rest):
        return errors_at_rest(case.truth, surface_map) >= RIGHT_ERROR
    truth = case.truth
    there, here = dominant(truth.target), dominant(surface_map.interpolate(truth.source))
    return _known_limbs(truth, there) & ~_same(truth.limb, there, here)


def errors_at_rest(truth: Rest, surface_map: zo.SurfaceMap) -> Floats:
    """(n_t,) distances in centimetres between the images and the true places, on the common body."""
    distance = np.linalg.norm(surface_map.interpolate(truth.source) - truth.target, axis=1)
    return np.asarray(distance / truth.unit)


def dominant(weights: Floats) -> Integers:
    """(n,) the bone with the largest weight (n, b); -1 where all are zero."""
    return np.where(weights.sum(axis=1) > WEIGHTED, np.argmax(weights, axis=1), -1)


def _of_bones(truth: Bones, surface_map: zo.SurfaceMap) -> Figures:
    arrived = surface_map.interpolate(truth.source)
    there, here = dominant(truth.target), dominant(arrived)
    on_bone = (there >= 0) & np.isin(there, np.flatnonzero((truth.source > 0).any(axis=0)))
    on_limb = _known_limbs(truth, there)
    sided = on_limb & (truth.side[there] != 0)
    opposite = (here >= 0) & (truth.side[here] == -truth.side[there])
    return Figures(
        dom=_share(there == here, on_bone),
        limb=_share(_same(truth.limb, there, here), on_limb),
        side=_share(opposite, sided),
        l1=_share(np.abs(arrived - truth.target).sum(axis=1), on_bone),
    )


def _known_limbs(truth: Bones, there: Integers) -> Booleans:
    """(n_t,) which vertices of strongest bones (n_t,) are on limbs that the source has."""
    of_source = truth.limb[(truth.source > 0).any(axis=0)]
    return (there >= 0) & np.isin(truth.limb[there], of_source)


def _same(label: Integers, there: Integers, here: Integers) -> Booleans:
    """(n_t,) where two bones of each vertex have the same label (b,)."""
    return (here >= 0) & (label[here] == label[there])


def _share(values: Floats | Booleans, among: Booleans) -> float | None:
    """The mean of values (n,) among some vertices, None where there are none."""
    return float(values[among].mean()) if among.any() else None
