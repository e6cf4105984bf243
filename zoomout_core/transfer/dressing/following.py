# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion of the space around a body that takes another shape.

A place near the skin moves like the patch of skin below it. A place farther away moves like the mean of a wider patch,
which ignores local detail of the skin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.dressing.patches import Patches
from zoomout_core.transfer.frames import frames_of
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FollowingTuning(Tuning, set_by="outfits"):
    """The width of the patch of skin that a place follows.

    Attributes:
        nearest: standard deviation of the weights of a patch at the skin.
        spreading: growth of this standard deviation, as a share of the distance from the skin.
    """

    nearest: float = tuned(0.01, "at unit area", 1e-6, 1)
    spreading: float = tuned(0.4, "1", 0, 10)


FOLLOWING = FollowingTuning()


class Motion(NamedTuple):
    """The motion of places."""

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
        self._patches = Patches(before, body.triangles)
        self._moved = [
            (samples.interpolate(after), samples.interpolate(turns.reshape(-1, 9)).reshape(-1, 3, 3))
            for samples in self._patches.sets
        ]

    def motion(self, places: Floats) -> Motion:
        """The motion of places (q, 3)."""
        distance = self._patches.distances(places)
        images, motions = np.empty((len(places), 3)), np.empty((len(places), 3, 3))
        for patches in self._patches.around(places, FOLLOWING.nearest + FOLLOWING.spreading * distance):
            moved, turns = (values[patches.near] for values in self._moved[patches.set])
            offset = places[patches.which, None] - self._patches.sets[patches.set].places[patches.near]
            moved = moved + np.einsum("qkxy,qky->qkx", turns, offset)
            growth = np.einsum("qk,qk->q", patches.weights, np.linalg.norm(turns[:, :, 0], axis=2))
            rotations = nearest_rotations(np.einsum("qk,qkxy->qxy", patches.weights, turns))
            images[patches.which] = np.einsum("qk,qkx->qx", patches.weights, moved)
            motions[patches.which] = growth[:, None, None] * rotations
        return Motion(images, motions, distance)


def _turns(body: Surface, shape: Floats) -> Floats:
    """(n, 3, 3) rotation and growth of a body around each of its vertices."""
    reshaped = body.with_vertices(shape)
    used = body.working.vertex_of >= 0
    own = SurfaceMap.from_vertices(np.where(used, np.arange(len(used)), body.triangles[0, 0]), body)
    frames = frames_of(MappedTarget(body, reshaped, own, np.ones(len(used))))
    return np.asarray(frames.turns[reshaped.working.vertex_of])
