# SPDX-License-Identifier: GPL-3.0-or-later
"""The target as an elastic skin: its edges, turned and scaled, hold against what draws its vertices elsewhere.

As-rigid-as-possible surface modelling (Sorkine and Alexa 2007), with rotations that are averaged along the surface, and
with scales that are given. Positions are those of the target's working mesh, at unit area of the source.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import rotations_of_blends
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.transfer.frames import Frames, products_of_gradients

# What draws a vertex that nothing draws, so that parts of which this is true of all vertices have a place.
LEAST_PULL = 1e-6


@dataclass(frozen=True, eq=False)
class Pins:
    """Places of the working mesh that must come to given positions.

    Attributes:
        matrix: (p, n) barycentric coordinates of the places.
        positions: (p, 3) where to.
    """

    matrix: csr_array
    positions: Floats

    @property
    def vertices(self) -> Integers:
        """The corners of the places."""
        return np.unique(self.matrix.indices)

    def met(self, positions: Floats) -> Floats:
        """(n, 3) positions of which only the places' corners are moved, as little as it takes."""
        if not len(self.positions):
            return positions
        missing = self.positions - self.matrix @ positions
        compliance = np.linalg.pinv((self.matrix @ self.matrix.T).toarray(), hermitian=True)
        return np.asarray(positions + self.matrix.T @ (compliance @ missing))


def no_pins(n: int) -> Pins:
    """None, for a working mesh of n vertices."""
    return Pins(csr_array((0, n)), np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class Skin:
    """The target's working mesh at rest, and how it is to be scaled.

    Attributes:
        rest: (n, 3) its vertices,
        normals: (n, 3) and their normals.
        corners: (m, 3) its triangles, wound outwards.
        stiffness: (n, n) of its edges.
        areas: (n,) of its vertices.
        scales: (n,) how long its edges should be, over what they are at rest.
        handedness: (n,) -1 where the map mirrors it, else 1.
        averaging: averages values along the surface by area, over a length at unit area.
    """

    rest: Floats
    normals: Floats
    corners: Integers
    stiffness: csc_array
    areas: Floats
    scales: Floats
    handedness: Floats
    averaging: ScreenedSmoothing

    @classmethod
    def of(cls, frames: Frames, averaged_over: float) -> Skin:
        """That of a target of which frames at all vertices are known.

        Args:
            frames: of the target's working mesh.
            averaged_over: length over which values are averaged, at unit area.
        """
        working, areas, stiffness = frames.mapped.target.working, frames.areas, frames.stiffness
        turns = np.linalg.det(frames.turns)
        scales = working.scale / np.sqrt(frames.mapped.source.area) / np.cbrt(np.abs(turns))
        averaging = ScreenedSmoothing.of(areas, stiffness, averaged_over)
        shape = working.vertices, working.vertex_normals, working.oriented_triangles
        return cls(*shape, stiffness, areas, scales, np.sign(turns), averaging)

    def loads(self, rotations: Floats) -> Floats:
        """(n, 3) what the stiffness makes of positions whose edges are those at rest, turned (n, 3, 3) and scaled."""
        # As `turned_gradients` makes them, which takes many times as long to put together.
        turns = self.scales[:, None, None] * rotations
        turned = np.einsum("nij,nj->ni", turns, self.rest)
        around = (self.stiffness @ turns.reshape(-1, 9)).reshape(-1, 3, 3)
        own = np.einsum("nij,nj->ni", turns, self.stiffness @ self.rest)
        return np.asarray((own + self.stiffness @ turned - np.einsum("nij,nj->ni", around, self.rest)) / 2)


class PinnedSystem:
    """A sparse symmetric positive definite system, whose solutions meet pins.

    Args:
        factors: of its (n, n) matrix.
        pins: what must be met.
    """

    def __init__(self, factors: SuperLU, pins: Pins) -> None:
        self._factors, self._pins = factors, pins
        self._answer, self._compliance = np.zeros((factors.shape[0], 0)), np.zeros((0, 0))
        if len(pins.positions):
            self._answer = self._free(pins.matrix.T.toarray())
            self._compliance = np.linalg.pinv(pins.matrix @ self._answer, hermitian=True)

    def _free(self, loads: Floats) -> Floats:
        """(n, d) solutions for loads (n, d), whatever is pinned."""
        return np.asarray(self._factors.solve(np.asfortranarray(loads)))

    def solve(self, loads: Floats) -> Floats:
        """(n, 3) solutions for loads (n, 3), moved as little, by the system, as it takes to meet the pins."""
        free = self._free(loads)
        return np.asarray(free + self._answer @ (self._compliance @ (self._pins.positions - self._pins.matrix @ free)))


class Elastic:
    """The linear system of a skin whose vertices are drawn somewhere.

    Args:
        skin: the skin.
        pull: (n,) how much each vertex is drawn, in [0, 1].
        length: over which edges hold against that, at unit area.
        pins: what must be met, however the rest is drawn.
    """

    def __init__(self, skin: Skin, pull: Floats, length: float, pins: Pins) -> None:
        self._skin = skin
        self._smoothing = ScreenedSmoothing.of(np.maximum(pull, LEAST_PULL) * skin.areas, skin.stiffness, length)
        self._system = PinnedSystem(self._smoothing.factors, pins)
        self._averaging = self._smoothing if length > skin.averaging.length else skin.averaging

    def solve(self, feet: Floats, loads: Floats) -> Floats:
        """(n, 3) positions that are drawn to feet (n, 3), while edges hold: `Skin.loads`."""
        return self._system.solve(self._smoothing.loads(feet, loads))

    def turns(self, positions: Floats) -> Floats:
        """(n, 3, 3) how the skin has turned where it is at positions (n, 3), on average around each vertex."""
        skin = self._skin
        products = products_of_gradients(skin.stiffness, positions, skin.rest)
        # Nothing of a flat patch says how its normals turn, but they themselves.
        size = skin.areas * skin.scales * skin.handedness
        normals = vertex_normals(positions, skin.corners)
        products += size[:, None, None] * normals[:, :, None] * skin.normals[:, None, :]
        averaged = self._averaging.solve(products.reshape(-1, 9)).reshape(-1, 3, 3)
        sense = skin.handedness[:, None, None]
        return sense * rotations_of_blends(sense * averaged)

    def spread(self, values: Floats) -> Floats:
        """Values (n, d), smoothed as far as vertices are drawn, and going on where they are not."""
        return self._smoothing.smooth(values)
