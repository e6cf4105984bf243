# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion of the space around a body that takes another shape.

A place near the skin moves like the patch of skin beneath it. A place farther away moves like the mean of a wider
patch, which ignores local detail of the skin. Patches are sampled at several densities, so that a wide patch needs no
more samples than a small one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import rotations_of_blends
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.threads import threads
from zoomout_core.transfer.frames import frames_of
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FollowingTuning(Tuning, set_by="outfits"):
    """The width of the patch of skin that a place follows.

    Attributes:
        samples: number of samples of the skin for the smallest patches; each further set has a quarter of the previous
            one.
        sets: number of sets of samples.
        neighbours: number of samples that a place follows.
        nearest: standard deviation of the weights of a patch at the skin.
        spreading: growth of this standard deviation, as a share of the distance from the skin.
        reach: maximum standard deviation for using a set, relative to the distance between its neighbouring samples.
    """

    samples: int = tuned(20_480, "points", 100, 10_000_000)
    sets: int = tuned(5, "sets", 1, 10)
    neighbours: int = tuned(40, "points", 1, 1000)
    nearest: float = tuned(0.01, "at unit area", 1e-6, 1)
    spreading: float = tuned(0.4, "1", 0, 10)
    reach: float = tuned(1.3, "1", 0.1, 10)


FOLLOWING = FollowingTuning()


class Motion(NamedTuple):
    """How places move."""

    images: Floats  # (q, 3) their new positions
    turns: Floats  # (q, 3, 3) rotation and growth of their surroundings
    distance: Floats  # (q,) their original distance from the skin

    @property
    def growth(self) -> Floats:
        """(q,) growth of their surroundings."""
        return np.linalg.norm(self.turns[:, 0], axis=1)


class Following:
    """The space around a body that takes another shape, given by the new positions (n, 3) of its vertices.

    Places are in units in which the original body has unit area, and its median growth is 1.

    Attributes:
        unit: unit of places before, in the body's unit.
        unit_after: unit of places after, in the shape's unit.
    """

    def __init__(self, body: Surface, shape: Floats) -> None:
        turns = _turns(body, shape)
        growth = np.linalg.norm(turns[:, 0], axis=1)
        self.unit = float(np.sqrt(body.area))
        self.unit_after = self.unit * float(np.median(growth))
        before, after, turns = body.vertices / self.unit, shape / self.unit_after, turns / np.median(growth)
        self._sets = []
        for number in range(FOLLOWING.sets):
            count = max(1, FOLLOWING.samples // 4**number)
            places, triangle = surface_samples(before, body.triangles, count)
            corners = body.triangles[triangle]
            weights, _ = closest_on_triangles(places, *before[corners].transpose(1, 0, 2))
            images = np.einsum("sc,scx->sx", weights, after[corners])
            turned = np.einsum("sc,scxy->sxy", weights, turns[corners])
            self._sets.append(_Samples(places, images, turned, cKDTree(places)))

    def motion(self, places: Floats) -> Motion:
        """How places (q, 3) move."""
        distance = np.asarray(self._sets[0].tree.query(places, workers=threads())[0])
        width = FOLLOWING.nearest + FOLLOWING.spreading * distance
        last = np.zeros(len(places), dtype=np.int64)
        for number, samples in enumerate(self._sets[:-1]):
            last[width > FOLLOWING.reach * samples.spacing] = number + 1
        images, turns = np.empty((len(places), 3)), np.empty((len(places), 3, 3))
        for number, samples in enumerate(self._sets):
            some = np.flatnonzero(last == number)
            if len(some):
                images[some], turns[some] = samples.motion(places[some], width[some])
        return Motion(images, turns, distance)


class _Samples(NamedTuple):
    """Samples of the skin."""

    places: Floats  # (s, 3) positions before
    images: Floats  # (s, 3) positions after
    turns: Floats  # (s, 3, 3) rotation and growth of their surroundings
    tree: cKDTree  # search tree of the places

    @property
    def spacing(self) -> float:
        """The distance between neighbours, at unit area."""
        return float(len(self.places) ** -0.5)

    def motion(self, places: Floats, width: Floats) -> tuple[Floats, Floats]:
        """(q, 3) images and (q, 3, 3) turns of places (q, 3) that follow patches of a width (q,)."""
        count = min(FOLLOWING.neighbours, len(self.places))
        found = self.tree.query(places, count, workers=threads())
        distance, near = (np.asarray(each).reshape(len(places), count) for each in found)
        weights = np.exp((distance[:, :1] ** 2 - distance**2) / (2 * width[:, None] ** 2))
        weights /= weights.sum(axis=1, keepdims=True)
        offset = places[:, None] - self.places[near]
        turns = self.turns[near]
        moved = self.images[near] + np.einsum("qkxy,qky->qkx", turns, offset)
        growth = np.einsum("qk,qk->q", weights, np.linalg.norm(turns[:, :, 0], axis=2))
        rotations = rotations_of_blends(np.einsum("qk,qkxy->qxy", weights, turns))
        return np.einsum("qk,qkx->qx", weights, moved), growth[:, None, None] * rotations


def _turns(body: Surface, shape: Floats) -> Floats:
    """(n, 3, 3) rotation and growth of a body around each of its vertices."""
    reshaped = body.with_vertices(shape)
    used = body.working.vertex_of >= 0
    own = SurfaceMap.from_vertices(np.where(used, np.arange(len(used)), body.triangles[0, 0]), body)
    frames = frames_of(MappedTarget(body, reshaped, own, np.ones(len(used))))
    return np.asarray(frames.turns[reshaped.working.vertex_of])
