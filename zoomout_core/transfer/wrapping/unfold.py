# SPDX-License-Identifier: GPL-3.0-or-later
"""Onto the source, with no face turned over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.mesh.triangles import area_normals, triangle_normals, unique_edges
from zoomout_core.runtime.progress import advance
from zoomout_core.transfer.wrapping.elastic import LEAST_PULL, Elastic
from zoomout_core.transfer.wrapping.fit import Fit
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class UnfoldTuning(Tuning, set_by="wrap"):
    """What is done where faces turn over.

    Attributes:
        relaxations: in which the surroundings of such faces are relaxed along the source, at most.
        averagings: of a vertex with its neighbours in each of these.
        retreats: in which vertices go half the way back from the source, at most.
        least_area: of a face, over what its scale makes of it, below which it counts as turned over.
        releases: in which the source lets go of vertices, so that they keep the form of what is around, at most.
    """

    relaxations: int = tuned(5, "rounds", 0, 100)
    averagings: int = tuned(6, "rounds", 1, 1000)
    retreats: int = tuned(5, "rounds", 0, 100)
    least_area: float = tuned(0.001, "1", 0, 1)
    releases: int = tuned(10, "rounds", 1, 100)


UNFOLD = UnfoldTuning()


class Unfolding:
    """A fitted target, on its way onto the source without faces that turn over.

    Faces are relaxed along the source first; vertices of those that stay turned over retreat towards where the skin
    would have them; and where the skin itself is folded, the source lets go of it.

    Args:
        fit: what has run.
    """

    def __init__(self, fit: Fit) -> None:
        self._fit, self._corners = fit, fit.working.oriented_triangles
        n = len(fit.weight)
        edges, _ = unique_edges(self._corners)
        rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
        self._means = csr_array((1 / np.bincount(rows, minlength=n)[rows], (rows, columns)), shape=(n, n))
        self._normals = triangle_normals(fit.working.vertices, self._corners)
        self._expected = self._turned(fit.turns)
        scales = fit.skin.scales[self._corners].mean(axis=1)
        self._area = scales**2 * np.linalg.norm(area_normals(fit.working.vertices, self._corners), axis=1)
        self._free = np.ones(n, dtype=bool)
        self._free[fit.pins.vertices] = False

    def run(self) -> Floats:
        """(n, 3) positions on the source, as far as no face turns over."""
        fit = self._fit
        turns = fit.turns
        normals = fit.turned_normals(fit.working.vertex_normals, fit.turns)
        pull, onto = fit.weight, fit.weight * fit.feet.facing(fit.feet.outwards[:, None] * normals)
        for release in range(UNFOLD.releases):
            elastic = Elastic(fit.skin, pull, fit.length, fit.pins)
            skin = elastic.solve(fit.feet.places, fit.skin.loads(turns))
            if release:  # what was let go turns with its surroundings
                turns = elastic.turns(skin)
                skin, self._expected = elastic.solve(fit.feet.places, fit.skin.loads(turns)), self._turned(turns)
            advance((release + 0.5) / UNFOLD.releases)
            skin = skin + elastic.spread(fit.feet.places - skin)
            onto = np.minimum(onto, pull)
            positions, onto = self._relaxed(skin, onto)
            turned = self.turned_over(positions)
            if not turned.any():
                break
            held = self._at(turned | self.turned_over(skin)).astype(np.float64)
            for _ in range(release + release // 2 + 1):
                held = np.maximum(held, self._means @ held)
            pull = np.maximum(pull * (1 - held), LEAST_PULL)
            advance((release + 1) / UNFOLD.releases)
        return self._evened(positions)

    def _evened(self, positions: Floats) -> Floats:
        """(n, 3) positions of which the surroundings of faces that are still turned over are flat, off the source.

        Where that does not turn them back, they stay as they are.
        """
        best, least = positions, int(self.turned_over(positions).sum())
        for number in range(UNFOLD.releases):
            turned = self.turned_over(positions)
            if turned.sum() < least:
                best, least = positions, int(turned.sum())
            if not turned.any():
                break
            around = self._at(turned)
            for _ in range(1 + number // 2):
                around |= self._means @ around > 0
            some = np.flatnonzero(around & self._free)
            means, positions = self._means[some], positions.copy()
            for _ in range(UNFOLD.averagings):
                positions[some] = means @ positions
        return best

    def turned_over(self, positions: Floats) -> Booleans:
        """(m,) which triangles of the working mesh face against the way that their surroundings have turned.

        Those of which next to nothing is left are among them.
        """
        facing = np.einsum("mx,mx->m", area_normals(positions, self._corners), self._expected)
        return np.asarray(facing <= UNFOLD.least_area * self._area)

    def _turned(self, turns: Floats) -> Floats:
        """(m, 3) normals of the triangles, as their corners have turned (n, 3, 3)."""
        return self._fit.turned_normals(self._normals, turns[self._corners].mean(axis=1))

    def _relaxed(self, skin: Floats, onto: Floats) -> tuple[Floats, Floats]:
        """(n, 3) positions between those of the skin (n, 3) and feet, and (n,) how far from the one to the other.

        Feet move along the source, then vertices retreat from them, until no face turns over.
        """
        feet = self._fit.feet
        positions = skin + onto[:, None] * (feet.places - skin)
        for number in range(UNFOLD.relaxations + UNFOLD.retreats):
            turned = self.turned_over(positions)
            if not turned.any():
                break
            around = self._at(turned)
            if number < UNFOLD.relaxations:
                for _ in range(1 + number // 2):
                    around |= self._means @ around > 0
                some = np.flatnonzero(around & self._free)
                means, weight = self._means[some], onto[some, None]
                for _ in range(UNFOLD.averagings):
                    positions[some] = means @ positions
                    feet.walk(positions[some], some)
                    positions[some] += weight * (feet.places[some] - positions[some])
            else:
                back = around.astype(np.float64)
                onto = onto * (1 - np.maximum(back, self._means @ back) / 2)
            positions = skin + onto[:, None] * (feet.places - skin)
        return positions, onto

    def _at(self, triangles: Booleans) -> Booleans:
        """(n,) which vertices are corners of some triangles (m,)."""
        chosen = np.zeros(len(self._free), dtype=bool)
        chosen[self._corners[triangles]] = True
        return chosen
