# SPDX-License-Identifier: GPL-3.0-or-later
"""Move the fitted target onto the source, without folded faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import area_normals, at_any, triangle_normals
from zoomout_core.runtime.progress import advance
from zoomout_core.transfer.wrapping.elastic import MIN_PULL, neighbour_means
from zoomout_core.transfer.wrapping.fit import Fit, turn_normals
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class UnfoldTuning(Tuning, set_by="wrap"):
    """How to repair folded faces.

    Attributes:
        relaxations: maximum number of rounds that relax the surroundings of folded faces along the source.
        averagings: number of averagings of a vertex with its neighbours in each of these rounds.
        retreats: maximum number of rounds in which vertices retreat half the way from the source.
        min_area: area of a face, relative to its scaled area at rest, below which it counts as folded.
        releases: maximum number of rounds that release vertices from the source, so that they keep their own form.
    """

    relaxations: int = tuned(5, "rounds", 0, 100)
    averagings: int = tuned(6, "rounds", 1, 1000)
    retreats: int = tuned(5, "rounds", 0, 100)
    min_area: float = tuned(0.001, "1", 0, 1)
    releases: int = tuned(10, "rounds", 1, 100)


UNFOLD = UnfoldTuning()
# Distance up to which the release of a vertex moves others, in lengths over which edges resist: there the motion has
# decreased by about exp(-5).
REACH = 5


class Unfolding:
    """Moves a fitted target to the source, and repairs faces that fold.

    Folded faces are relaxed along the source first. Vertices of faces that stay folded retreat to their elastic
    positions. Where these are folded as well, vertices are released from the source.

    Args:
        fit: the completed fit of the target.
    """

    def __init__(self, fit: Fit) -> None:
        self._fit, self._corners = fit, fit.working.oriented_triangles
        n = len(fit.weight)
        self._means = neighbour_means(self._corners, n)
        self._normals = triangle_normals(fit.working.vertices, self._corners)
        self._expected = self._turn_normals(fit.turns, slice(None))
        scales = fit.rest_mesh.scales[self._corners].mean(axis=1)
        self._area = scales**2 * np.linalg.norm(area_normals(fit.working.vertices, self._corners), axis=1)
        self._free = ~np.isin(np.arange(n), fit.pins.vertices)

    def run(self) -> Floats:
        """(n, 3) positions on the source, except where faces would fold."""
        fit, turns = self._fit, self._fit.turns
        normals = turn_normals(fit.working.vertex_normals, fit.turns)
        pull, onto = fit.weight, fit.weight * fit.projections.facing(fit.projections.outwards[:, None] * normals)
        places, elastic = fit.projections.places, fit.elastic
        solved = elastic.solve(places, fit.rest_mesh.loads(turns))
        smoothed = elastic.smooth(places - solved)
        some: Integers = np.empty(0, dtype=np.int64)  # the vertices that the last release moves
        for release in range(UNFOLD.releases):
            if len(some):
                places, turns = fit.projections.places, turns.copy()
                patch = elastic.release(pull, some)
                solved = patch.solve(places, fit.rest_mesh.loads(turns), solved)
                turns[some] = elastic.turns(solved, some)
                solved = patch.solve(places, fit.rest_mesh.loads(turns), solved)
                smoothed = patch.smooth(places - solved, smoothed)
                near = self._triangles_at(some)
                self._expected[near] = self._turn_normals(turns, near)
            advance((release + 0.5) / UNFOLD.releases)
            onto = np.minimum(onto, pull)
            positions, onto = self._relax(solved + smoothed, onto)
            turned = self.turned_triangles(positions)
            if not turned.any():
                break
            held = self._at(turned | self.turned_triangles(solved + smoothed)).astype(np.float64)
            for _ in range(release + release // 2 + 1):
                held = np.maximum(held, self._means @ held)
            pull = np.maximum(pull * (1 - held), MIN_PULL)
            # Released vertices move and rotate with their surroundings; vertices farther away hardly move.
            some = self._free_near(held > 0)
            advance((release + 1) / UNFOLD.releases)
        return self._flatten(positions)

    def _flatten(self, positions: Floats) -> Floats:
        """(n, 3) positions, averaged around faces that are still folded, of the round with the fewest folded faces."""
        turned = self.turned_triangles(positions)
        best, least = positions, int(turned.sum())
        for number in range(UNFOLD.releases):
            if turned.sum() < least:
                best, least = positions, int(turned.sum())
            if not turned.any():
                break
            some = self._free_around(turned, 1 + number // 2)
            means, positions = self._means[some], positions.copy()
            for _ in range(UNFOLD.averagings):
                positions[some] = means @ positions
            near = self._triangles_at(some)
            turned[near] = self.turned_triangles(positions, near)
        return best

    def turned_triangles(self, positions: Floats, near: Integers | slice = slice(None)) -> Booleans:
        """(q,) which of some triangles (q,) face against their rotated surroundings, or have no area."""
        facing = np.einsum("mx,mx->m", area_normals(positions, self._corners[near]), self._expected[near])
        return np.asarray(facing <= UNFOLD.min_area * self._area[near])

    def _turn_normals(self, turns: Floats, near: Integers | slice) -> Floats:
        """(q, 3) normals of some triangles (q,), rotated by the mean of the rotations (n, 3, 3) of their corners."""
        return turn_normals(self._normals[near], turns[self._corners[near]].mean(axis=1))

    def _relax(self, elastic_positions: Floats, onto: Floats) -> tuple[Floats, Floats]:
        """(n, 3) positions between elastic positions (n, 3) and projections, and (n,) the fraction of the way.

        Projections move along the source, then vertices retreat from them, until no face is folded.
        """
        projections = self._fit.projections
        positions = elastic_positions + onto[:, None] * (projections.places - elastic_positions)
        turned = self.turned_triangles(positions)
        for number in range(UNFOLD.relaxations + UNFOLD.retreats):
            if not turned.any():
                break
            if number < UNFOLD.relaxations:
                some = self._free_around(turned, 1 + number // 2)
                means, weight = self._means[some], onto[some, None]
                for _ in range(UNFOLD.averagings):
                    positions[some] = means @ positions
                    projections.walk(positions[some], some)
                    positions[some] += weight * (projections.places[some] - positions[some])
            else:
                back = self._at(turned).astype(np.float64)
                some = np.flatnonzero(self._means @ back + back)
                onto = onto * (1 - np.maximum(back, self._means @ back) / 2)
            positions = elastic_positions + onto[:, None] * (projections.places - elastic_positions)
            near = self._triangles_at(some)  # no others have changed
            turned[near] = self.turned_triangles(positions, near)
        return positions, onto

    def _at(self, triangles: Booleans) -> Booleans:
        """(n,) which vertices are corners of some triangles (m,)."""
        return np.isin(np.arange(len(self._free)), self._corners[triangles])

    def _triangles_at(self, vertices: Integers) -> Integers:
        """(q,) the triangles with a corner among some vertices (s,)."""
        chosen = np.zeros(len(self._free), dtype=bool)
        chosen[vertices] = True
        return np.flatnonzero(at_any(chosen, self._corners))

    def _free_around(self, triangles: Booleans, rings: int) -> Integers:
        """The vertices within some rings of some triangles (m,) that are not pinned."""
        return np.flatnonzero(self._grow(self._at(triangles), rings) & self._free)

    def _free_near(self, vertices: Booleans) -> Integers:
        """The vertices that the release of some vertices (n,) moves, and that are not pinned."""
        rings = 1 + int(np.ceil(REACH * self._fit.length * np.sqrt(len(vertices))))
        return np.flatnonzero(self._grow(vertices, rings) & self._free)

    def _grow(self, vertices: Booleans, rings: int) -> Booleans:
        """(n,) which vertices are within some rings of some of them (n,)."""
        for _ in range(rings):
            vertices = vertices | (self._means @ vertices > 0)
        return vertices
