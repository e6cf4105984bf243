# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact: keep the distance of worn objects from the skin, and from layers beneath them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, eye_array, kron, vstack
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST, procrustes
from zoomout_core.geometry.screened_smoothing import screened_stiffness
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.maps.surface_map import interpolation_matrix
from zoomout_core.transfer.dressing.barriers import CONTACT, Barrier, Bounds, Margins, SidedSurface
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.transfer.dressing.kept_parts import KeptParts

# Range of a push, relative to the length over which it is spread.
PUSHED = 6.0
# Stiffness of rotations of parts without extent, as a share of the mean of the diagonal.
TURNING = 1e-9


class _BarrierBounds:
    """Places that must stay on their side of a barrier. They are tested again only if they may have come too close.

    Args:
        barrier: the barrier after the change of shape.
        is_layer: whether it is another worn object.
        which: (b,) numbers of the places.
        margin: (b,) the distance that they must keep.
        at: (b, 3) their positions.
    """

    def __init__(self, barrier: SidedSurface, is_layer: bool, which: Integers, margin: Floats, at: Floats) -> None:
        off, normals, known = barrier.sides(at)
        some = off < margin + CONTACT.looked_at
        # Layers are open: a place may change sides without coming close, around a border.
        self._skin, self._flips = barrier, is_layer
        self._which, self._margin = which[some], margin[some]
        self._at, self._off, self._normals, self._known = at[some], off[some], normals[some], known[some]

    def pushes(self, places: Floats) -> tuple[Integers, Floats]:
        """(v,) numbers of the places (p, 3) that are too close, and (v, 3) how they must move."""
        self._test(places)
        missing = self._margin - self._off
        some = self._known & (missing > CONTACT.settled) & (missing < CONTACT.reach)
        return self._which[some], missing[some, None] * self._normals[some]

    def count_inside(self, places: Floats) -> int:
        """The number of places (p, 3) on the other side of the barrier."""
        self._test(places)
        return int(((self._off < 0) & self._known).sum())

    def _test(self, places: Floats) -> None:
        """Measure the distances of places (p, 3) that may be too close after moving, or have changed sides."""
        at = places[self._which]
        moved = np.linalg.norm(at - self._at, axis=1)
        again = np.flatnonzero((moved > 0) & (self._flips | (self._off - moved < np.maximum(self._margin, 0))))
        if len(again):
            self._at[again] = at[again]
            self._off[again], self._normals[again], self._known[again] = self._skin.sides(at[again])


class _Side(NamedTuple):
    """Places that were originally near a barrier, and may change sides."""

    which: Integers  # (b,) numbers of the places
    off: Floats  # (b,) their original distances from it
    is_layer: bool  # whether the barrier is another worn object

    @classmethod
    def of(cls, barrier: Barrier, probes: csr_array, form: Form) -> _Side:
        """Those of the places that a matrix (p, n) interpolates from a form at rest."""
        places, part = probes @ form.rest, form.component[probes.indices[probes.indptr[:-1]]]
        reach = CONTACT.layer_reach if barrier.is_layer else CONTACT.reach
        beside = barrier.before.beside(places, reach)
        off, _, known = barrier.before.sides(places[beside])
        if barrier.is_layer:
            near = known & (np.abs(off) < reach)
            above, of = near & (off > 0), part[beside]
            stacked = np.bincount(of, above) >= CONTACT.over * np.bincount(of, near)
            chosen = above & stacked[of]
        else:
            # A part that keeps its form, such as a sole, may stay in the skin where it was before.
            mended = np.where((probes @ form.keep)[beside] > 0, 0.0, CONTACT.mended)
            chosen = known & (off > -mended) & (off < reach)
        return cls(beside[chosen], off[chosen], barrier.is_layer)

    def only(self, chosen: Booleans) -> _Side:
        """Restrict them to the chosen places (p,)."""
        some = chosen[self.which]
        return self._replace(which=self.which[some], off=self.off[some])

    def bounds(self, barrier: SidedSurface, growth: Floats, margins: Margins, now: Floats) -> _BarrierBounds:
        """Their bounds beside the barrier after the change, for all places (p, 3) with their growth (p,)."""
        smallest, largest = (0.0, CONTACT.max_margin) if self.is_layer else margins
        margin = np.clip(self.off * growth[self.which], smallest, largest)
        return _BarrierBounds(barrier, self.is_layer, self.which, margin, now[self.which])


class Contact:
    """The places at which a soft form keeps its distance from barriers, prepared for changes of shape.

    Args:
        form: the form at rest.
        positions: (n, 3) its positions after the change.
        barriers: surfaces that it must not enter; the first is the skin.
        soft: the points that may be pushed.

    Attributes:
        probes: (p, n) matrix that interpolates the places to test.
    """

    def __init__(self, form: Form, positions: Floats, barriers: Sequence[Barrier], soft: Integers) -> None:
        probes = form.probes(soft, CONTACT.fine)
        if len(form.between(soft)):
            probes = csr_array(vstack([probes, _beside(barriers[0].after, positions, form.between(soft))]))
        self._form, self.probes = form, probes
        self._sides = [_Side.of(barrier, probes, form) for barrier in barriers]
        self._areas = probes @ (form.areas / np.maximum(probes.sum(axis=0), SMALLEST))
        self._kept = KeptParts.of(form)

    def push_out(
        self,
        positions: Floats,
        growth: Floats,
        barriers: Sequence[SidedSurface],
        margins: Margins,
        moving: Booleans | None = None,
        more: Sequence[Bounds] = (),
        spread: float | None = None,
    ) -> tuple[Floats, int]:
        """Push the form smoothly out of barriers that it was outside of. Kept parts are displaced as a whole.

        Args:
            positions: (n, 3) its current positions.
            growth: (n,) growth of its surroundings.
            barriers: the barriers after the change.
            margins: bounds of the distance from the skin that is kept.
            moving: (n,) the points that may be pushed; all soft ones if omitted.
            more: further bounds of the places to test.
            spread: length over which a push is spread; `ContactTuning.spread` if omitted.

        Returns:
            (n, 3) positions, and the number of places that are still in the skin.
        """
        probes, sides, length = self.probes, self._sides, CONTACT.spread if spread is None else spread
        if moving is not None:
            is_tested = (probes @ ~moving) == 0
            sides = [side.only(is_tested) for side in sides]
        now, growth = probes @ positions, probes @ growth
        bounds = [side.bounds(after, growth, margins, now) for side, after in zip(sides, barriers, strict=True)]
        positions, staying = positions.copy(), screened_stiffness(self._form.areas, self._form.stiffness, length)
        for _ in range(CONTACT.rounds):
            which, pushes = _pushes([*bounds, *more], probes @ positions)
            if not len(which):
                break
            touched = csr_array(probes[which])
            free = self._around(np.unique(touched.indices), length)
            weights = CONTACT.firmness * self._areas[which]
            positions[free] += self._displace(
                free, positions, staying[free][:, free], touched[:, free], weights, pushes
            )
        return positions, bounds[0].count_inside(probes @ positions)

    def _displace(
        self,
        free: Integers,
        positions: Floats,
        staying: csc_array,
        touched: csr_array,
        weights: Floats,
        pushes: Floats,
    ) -> Floats:
        """(f, 3) displacements of free points that push places, which a matrix (v, f) interpolates, by weights (v,).

        Args:
            free: numbers of the points, with whole kept parts.
            positions: (n, 3) positions of all points.
            staying: (f, f) resistance of the free points to displacements.
            touched: (v, f) matrix that interpolates the pushed places.
            weights: (v,) of the pushes.
            pushes: (v, 3) how the places must move.
        """
        loads = weights[:, None] * pushes
        if not self._kept.weights[free].any():
            matrix = csc_array(staying + touched.T @ diags_array(weights) @ touched)
            return np.asarray(factorise(matrix).solve(np.asfortranarray(touched.T @ loads)))
        motions = self._kept.motions(free, positions)
        in_space = eye_array(3)
        there = csr_array(kron(touched, in_space)) @ motions.matrix
        matrix = motions.matrix.T @ kron(staying, in_space, format="csr") @ motions.matrix
        matrix += there.T @ diags_array(np.repeat(weights, 3)) @ there
        # Parts without extent, such as single points, have no defined rotation.
        matrix += TURNING * matrix.diagonal().mean() * eye_array(matrix.shape[0])
        return motions.displace(factorise(csc_array(matrix)).solve(there.T @ loads.ravel()))

    def _around(self, chosen: Integers, spread: float) -> Integers:
        """(f,) the points that a push at chosen ones reaches, spread over a length, with whole kept parts."""
        points, whole = self._form.rest, self._kept.with_whole_parts(chosen)
        distance, _ = cKDTree(points[whole]).query(points, distance_upper_bound=PUSHED * spread)
        return self._kept.with_whole_parts(np.flatnonzero(np.isfinite(distance)))


def push_out_rigidly(
    form: Form, positions: Floats, growth: Floats, barriers: Sequence[Barrier], margins: Margins
) -> tuple[Floats, int]:
    """`push_out` by a rigid motion of the whole form."""
    probes = form.probes(np.arange(len(form.rest)), CONTACT.fine)
    now, growth = probes @ positions, probes @ growth
    bounds = [_Side.of(each, probes, form).bounds(each.after, growth, margins, now) for each in barriers]
    for _ in range(CONTACT.rounds):
        places = probes @ positions
        which, pushes = _pushes(bounds, places)
        if not len(which):
            break
        wanted, weights = places.copy(), np.ones(len(places))
        np.add.at(wanted, which, pushes)
        weights[which] = CONTACT.firmness
        positions = procrustes(places, wanted, weights, scales=(1, 1))(positions)
    return positions, bounds[0].count_inside(probes @ positions)


def _beside(skin: SidedSurface, positions: Floats, triangles: Integers) -> csr_array:
    """(p, n) matrix that interpolates positions (n, 3) at the points of triangles (m, 3) nearest to skin vertices.

    At these points, detail of the skin may penetrate a coarser triangle.
    """
    surface = SidedSurface(positions, triangles, is_part=True)
    beside = skin.vertices[surface.beside(skin.vertices, CONTACT.looked_at)]
    triangle, barycentric, distance = surface.closest(beside)
    near = np.flatnonzero(distance < CONTACT.looked_at)
    return interpolation_matrix(triangles[triangle[near]], barycentric[near], len(positions))


def _pushes(bounds: Sequence[Bounds], places: Floats) -> tuple[Integers, Floats]:
    """(v,) numbers of places (p, 3) that are too close, possibly repeated, and (v, 3) how they must move."""
    found = [each.pushes(places) for each in bounds]
    return np.concatenate([which for which, _ in found]), np.concatenate([pushes for _, pushes in found])
