# SPDX-License-Identifier: GPL-3.0-or-later
"""What is worn stays outside of the skin, and of what is worn beneath it, by the distance that it had."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, vstack
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.geometry.screened_smoothing import screened_stiffness
from zoomout_core.geometry.sparse_solve import factorised
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ContactTuning(Tuning, set_by="dress"):
    """How what is worn is kept out of the skin.

    Attributes:
        reach: distance from the skin up to which a place is looked at,
        layer_reach: and from what is worn beneath.
        most_margin: distance from the skin that is kept, at most.
        least_margin: and at least.
        mended: how deep in the skin a place may have been to be brought out of it, where it is of a soft thing.
        facing: least cosine between the way to the skin and its normal from which on the side is known.
        spread: length over which a push is spread.
        firmness: what a push counts for beside staying.
        rounds: of looking and pushing, at most.
        settled: what may be missing of a margin.
        fine: length of edges that are so short that their ends are looked at alone.
        looked_at: distance from the margin beyond which a place is not looked at again.
    """

    reach: float = tuned(0.08, "at unit area", 0, 1)
    layer_reach: float = tuned(0.02, "at unit area", 0, 1)
    most_margin: float = tuned(0.01, "at unit area", 0, 1)
    least_margin: float = tuned(0.001, "at unit area", 0, 1)
    mended: float = tuned(0.01, "at unit area", 0, 1)
    facing: float = tuned(0.5, "1", 0, 1)
    spread: float = tuned(0.01, "at unit area", 1e-6, 1)
    firmness: float = tuned(30.0, "1", 0, 1e6)
    rounds: int = tuned(8, "rounds", 0, 100)
    settled: float = tuned(3e-4, "at unit area", 0, 1)
    fine: float = tuned(0.01, "at unit area", 0, 1)
    looked_at: float = tuned(0.02, "at unit area", 0, 1)


CONTACT = ContactTuning()
# A push has faded at so many times the length over which it is spread.
PUSHED = 6.0
# Guard against division by zero.
SMALLEST = 1e-300


class Skin:
    """A surface with two sides.

    Args:
        vertices: (n, 3) positions.
        triangles: (m, 3) vertex numbers, wound so that normals point outwards.
    """

    def __init__(self, vertices: Floats, triangles: Integers) -> None:
        self.vertices, self._triangles = vertices, triangles
        self._normals = vertex_normals(vertices, triangles)
        # By place alone: what is worn may face either way.
        self._search = OrientedSurface(vertices, triangles, np.zeros(len(triangles), dtype=bool), 0.0)

    def sides(self, points: Floats) -> tuple[Floats, Floats, Booleans]:
        """On which side of the skin points (p, 3) are.

        Returns:
            (p,) their distances, negative inside; (p, 3) the skin's normals; (p,) where the side is known: not beside
            a border.
        """
        triangle, barycentric, distance = self._search.closest(points, np.zeros_like(points))
        corners = self._triangles[triangle]
        off = points - np.einsum("pc,pcx->px", barycentric, self.vertices[corners])
        normals = unit_vectors(np.einsum("pc,pcx->px", barycentric, self._normals[corners]))
        along = np.einsum("px,px->p", off, normals)
        return np.where(along < 0, -distance, distance), normals, np.abs(along) >= CONTACT.facing * distance


class Barrier(NamedTuple):
    """What something is not to enter.

    Attributes:
        before: as it was.
        after: as it is.
        is_layer: whether it is something else that is worn: then what is beneath it, or far from it, is free.
    """

    before: Skin
    after: Skin
    is_layer: bool = False


class _Bounds(NamedTuple):
    """Places that are to stay on their side of a barrier.

    Attributes:
        skin: the barrier, as it is.
        which: (b,) the places.
        margin: (b,) how far off they are to stay.
    """

    skin: Skin
    which: Integers
    margin: Floats

    @classmethod
    def of(cls, barrier: Barrier, places: Floats, growth: Floats, gap: float) -> _Bounds:
        """Those of places (p, 3) as they were, whose surroundings grow (p,)."""
        off, _, known = barrier.before.sides(places)
        lowest, highest = (0.0, CONTACT.layer_reach) if barrier.is_layer else (-CONTACT.mended, CONTACT.reach)
        which = np.flatnonzero(known & (off > lowest) & (off < highest))
        least = 0.0 if barrier.is_layer else max(CONTACT.least_margin, gap)
        margin = np.clip(off[which] * growth[which], least, max(CONTACT.most_margin, least))
        return cls(barrier.after, which, margin)

    def near(self, places: Floats) -> _Bounds:
        """Those places, of all (p, 3) as they are, that may come to be on the other side."""
        off, _, _ = self.skin.sides(places[self.which])
        some = off < self.margin + CONTACT.looked_at
        return _Bounds(self.skin, self.which[some], self.margin[some])

    def among(self, chosen: Booleans) -> _Bounds:
        """Those of chosen places, of all (p,)."""
        some = chosen[self.which]
        return _Bounds(self.skin, self.which[some], self.margin[some])

    def pushes(self, places: Floats) -> tuple[Integers, Floats]:
        """(v,) places, of all (p, 3), that have come too near, and (v, 3) how far they are to move."""
        off, normals, known = self.skin.sides(places[self.which])
        missing = self.margin - off
        some = known & (missing > CONTACT.settled) & (missing < CONTACT.reach)
        return self.which[some], missing[some, None] * normals[some]


def held_off(
    form: Form, positions: Floats, growth: Floats, barriers: Sequence[Barrier], gap: float, soft: Integers
) -> tuple[Floats, int]:
    """Push a soft form smoothly out of what it was outside of.

    Args:
        form: at rest.
        positions: (n, 3) where it is.
        growth: (n,) how much larger its surroundings are.
        barriers: what it is not to enter.
        gap: how far off it is to stay at least.
        soft: its points that are pushed.

    Returns:
        (n, 3) positions, and how many places are still in the skin, the first of the barriers.
    """
    probes = form.probes(soft, CONTACT.fine)
    if len(form.between(soft)):
        probes = csr_array(vstack([probes, _beside(barriers[0].after, positions, form.between(soft))]))
    bounds = _bounds(barriers, probes, form, positions, growth, gap)
    areas = probes @ (form.areas / np.maximum(probes.sum(axis=0), SMALLEST))
    staying = screened_stiffness(form.areas, form.stiffness, CONTACT.spread)
    positions, moving = positions.copy(), bounds
    for _ in range(CONTACT.rounds):
        which, pushes = _pushes(moving, probes @ positions)
        if not len(which):
            break
        touched, weights = csr_array(probes[which]), CONTACT.firmness * areas[which]
        free = _around(form.rest, np.unique(touched.indices))
        there = touched[:, free]
        matrix = csc_array(staying[free][:, free] + there.T @ diags_array(weights) @ there)
        loads = there.T @ (weights[:, None] * pushes)
        positions[free] += factorised(matrix).solve(np.asfortranarray(loads))
        # Places that have not moved are where they were found to be right.
        is_free = np.isin(np.arange(len(positions)), free)
        moving = [each.among(probes @ is_free > 0) for each in bounds]
    return positions, _wrong(bounds, probes @ positions)


def held_off_as_a_whole(
    form: Form, positions: Floats, growth: Floats, barriers: Sequence[Barrier], gap: float
) -> tuple[Floats, int]:
    """`held_off` for what is rigid: it is moved and turned as a whole."""
    probes = form.probes(np.arange(len(form.rest)), CONTACT.fine)
    bounds = _bounds(barriers, probes, form, positions, growth, gap)
    for _ in range(CONTACT.rounds):
        places = probes @ positions
        which, pushes = _pushes(bounds, places)
        if not len(which):
            break
        wanted, weights = places.copy(), np.ones(len(places))
        np.add.at(wanted, which, pushes)
        weights[which] = CONTACT.firmness
        positions = procrustes(places, wanted, weights, scales=(1, 1))(positions)
    return positions, _wrong(bounds, probes @ positions)


def _around(points: Floats, chosen: Integers) -> Integers:
    """(f,) which of the points (n, 3) a push at chosen ones reaches."""
    reach = PUSHED * CONTACT.spread
    distance, _ = cKDTree(points[chosen]).query(points, distance_upper_bound=reach)
    return np.flatnonzero(np.isfinite(distance))


def _beside(skin: Skin, positions: Floats, triangles: Integers) -> csr_array:
    """(p, n) what gives of positions (n, 3) those on triangles (m, 3) that vertices of the skin are beside.

    There the skin may come through a triangle that is larger than what it has of detail.
    """
    search = OrientedSurface(positions, triangles, np.zeros(len(triangles), dtype=bool), 0.0)
    triangle, barycentric, distance = search.closest(skin.vertices, np.zeros_like(skin.vertices))
    near = np.flatnonzero(distance < CONTACT.looked_at)
    rows, corners = np.repeat(np.arange(len(near)), 3), triangles[triangle[near]]
    return csr_array((barycentric[near].ravel(), (rows, corners.ravel())), shape=(len(near), len(positions)))


def _bounds(
    barriers: Sequence[Barrier], probes: csr_array, form: Form, positions: Floats, growth: Floats, gap: float
) -> list[_Bounds]:
    found = (_Bounds.of(barrier, probes @ form.rest, probes @ growth, gap) for barrier in barriers)
    return [each.near(probes @ positions) for each in found]


def _pushes(bounds: list[_Bounds], places: Floats) -> tuple[Integers, Floats]:
    """(v,) places, of all (p, 3), that have come too near, some several times, and (v, 3) how far they are to move."""
    found = [each.pushes(places) for each in bounds]
    return np.concatenate([which for which, _ in found]), np.concatenate([pushes for _, pushes in found])


def _wrong(bounds: list[_Bounds], places: Floats) -> int:
    """How many places, of all (p, 3), are in the skin, the first of the bounds."""
    off, _, known = bounds[0].skin.sides(places[bounds[0].which])
    return int(((off < 0) & known).sum())
