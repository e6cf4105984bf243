# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigid placements of one of two fragments on the other, by which their surfaces overlap.

Distances between landmarks differ between species, and two fragments may share no tip. Where they overlap, however,
they are nearly in the same pose. For each of some rotations, pairs of places with similar normals vote for a shift (a
Hough transform; Ballard, Generalizing the Hough transform to detect arbitrary shapes, 1981). The placements with the
most votes are refined by rigid ICP (Besl and McKay, A method for registration of 3-D shapes, 1992) and ranked by their
overlap. Unlike a map of all places, a placement does not pull places without a partner onto the other fragment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.matching.ranking.scores import UP_AXES
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class RigidPlacementTuning(Tuning, set_by="official"):
    """How placements are found; lengths are those of the larger shape at unit area."""

    rotations: int = tuned(600, "rotations", 1, 100_000)  # number of rotations to test, about 25 degrees apart
    # Degrees between upright rotations about the up axis, and by which those beside them are tilted. Of 20 pairs of cut
    # animals, 8 have their right placement among the first 16 by all rotations, and 13 by upright ones, 12 of these
    # among the first four.
    upright_step: float = tuned(15.0, "degrees", 1, 180)
    tilt: float = tuned(25.0, "degrees", 0, 90)  # angle by which rotations beside the upright ones are tilted
    refined: int = tuned(150, "placements", 1, 100_000)  # number of placements with the most votes, which are refined
    kept: int = tuned(16, "placements", 1, 1000)  # number of placements that differ, by which the part is registered
    apart: float = tuned(0.12, "length", 0, 10)  # minimum mean distance between the positions of placements that differ


RIGID_PLACEMENTS = RigidPlacementTuning()
# Width of the cells in which votes are counted, about the distance between two places, and minimum cosine between the
# normals of a pair that votes. The rotations tried are off by up to 15 degrees, and shapes differ.
CELL, FACING = 0.1, 0.75
# Number of directions in which upright rotations are tilted; two neighbours are about as far apart as the tilt.
TILTS = 6
# Cells of each rotation that become placements.
CELLS_PER_ROTATION = 2
# Refinement: rounds, and the scale s, in length, of the weight 1 / (1 + (r / s)^2)^2 of a distance r.
ROUNDS, ROBUST_SCALE = 5, 0.08
# Distance in length that equals a unit difference of normals, in the search for nearest places.
NORMAL_WEIGHT = 0.2
# Two places overlap within this distance in length, and above this cosine of their normals.
NEAR, AGREEING = 0.1, 0.5
# A place whose nearest place is within this distance in length from a cut may have no partner.
NEAR_CUT = 0.06
# Areas are at least this, relative to the larger shape's, in the ranking.
MIN_AREA = 0.02
# Minimum number of places that overlap.
MIN_PLACES = 4


class Placement(NamedTuple):
    """A rigid placement of a part on a whole."""

    rank: float  # cost of the placement: the lowest is the best
    positions: Floats  # (n, 3) the part's vertices in the whole's frame
    places: Integers  # (d_p,) for each place of the part the nearest place of the whole with a similar normal


class _Places(NamedTuple):
    """Places of a shape."""

    points: Floats  # (d, 3)
    normals: Floats  # (d, 3)
    areas: Floats  # (d,) area that is nearest to each
    cut_distance: Floats  # (d,) to the nearest cut

    @classmethod
    def of(cls, shape: IncompleteShape) -> _Places:
        mesh, at = shape.shape.mesh, shape.shape.search.samples[: len(shape.between)]
        return cls(mesh.vertices[at], mesh.vertex_normals[at], shape.areas, shape.cut_distance)

    def move(self, rotation: Floats, shift: Floats) -> _Places:
        """The places after a rigid motion."""
        return self._replace(points=self.points @ rotation.T + shift, normals=self.normals @ rotation.T)

    def with_normals(self) -> Floats:
        """(d, 6) points and scaled normals, to search for near places with similar normals."""
        return np.hstack([self.points, NORMAL_WEIGHT * self.normals])


def rotations(count: int) -> Floats:
    """(count, 3, 3) rotations spread evenly (Alexa, Super-Fibonacci spirals, 2022)."""
    step = np.arange(count) + 0.5
    inner, outer = np.sqrt(step / count), np.sqrt(1 - step / count)
    # The constants of the paper: the square root of two, and the positive root of x^4 = x + 4.
    first, second = 2 * np.pi * step / np.sqrt(2), 2 * np.pi * step / 1.533751168755204288118041
    parts = inner * np.sin(first), inner * np.cos(first), outer * np.sin(second), outer * np.cos(second)
    return np.asarray(Rotation.from_quat(np.column_stack(parts)).as_matrix())


def upright_rotations(axis: int) -> Floats:
    """(r, 3, 3) rotations that turn a shape about an axis of its file, upright and slightly tilted."""
    directions = np.arange(TILTS) * 2 * np.pi / TILTS
    horizontal = np.radians(RIGID_PLACEMENTS.tilt) * np.column_stack([np.cos(directions), np.sin(directions)])
    horizontal = np.insert(horizontal, 0, 0, axis=0)  # the first is upright
    tilts = Rotation.from_rotvec(np.insert(horizontal, axis, 0, axis=1)).as_matrix()
    steps = np.radians(np.arange(0, 360, RIGID_PLACEMENTS.upright_step))
    turns = Rotation.from_rotvec(steps[:, None] * np.eye(3)[axis]).as_matrix()
    return np.asarray((tilts[:, None] @ turns).reshape(-1, 3, 3))


def rigid_placements(part: IncompleteShape, whole: IncompleteShape, upright: bool = False) -> list[Placement]:
    """Placements of a part on a whole that differ, the best first.

    If shapes are likely to stand `upright` in their files, half of them are found by rotations about an up axis.
    """
    here, there = _Places.of(part), _Places.of(whole)
    searched = [rotations(RIGID_PLACEMENTS.rotations)]
    if upright:
        searched.insert(0, np.concatenate([upright_rotations(axis) for axis in UP_AXES]))
    kept: list[_Placed] = []
    for number, tested in enumerate(searched, start=1):
        kept = _add_differing(kept, _place(tested, here, there), RIGID_PLACEMENTS.kept * number // len(searched))
    vertices = part.shape.mesh.vertices
    return [
        Placement(one.rank, vertices @ one.rotation.T + one.shift, one.places)
        for one in sorted(kept, key=lambda one: one.rank)
    ]


class _Placed(NamedTuple):
    """Places of a part after a rigid motion."""

    rank: float  # its cost
    rotation: Floats  # (3, 3)
    shift: Floats  # (3,)
    points: Floats  # (d_p, 3) where they are
    places: Integers  # (d_p,) nearest places of the whole


def _place(tested: Floats, here: _Places, there: _Places) -> list[_Placed]:
    """Placements by the rotations (r, 3, 3) and shifts with the most votes, refined, the best first."""
    tree = cKDTree(there.with_normals())
    found = []
    for rotation, shift in _vote(tested, here, there):
        rotation, shift = _refine(rotation, shift, here, there, tree)
        placed = here.move(rotation, shift)
        rank, places = _rank(placed, there, tree)
        if np.isfinite(rank):
            found.append(_Placed(rank, rotation, shift, placed.points, places))
    return sorted(found, key=lambda one: one.rank)


def _add_differing(kept: Sequence[_Placed], found: Sequence[_Placed], max_count: int) -> list[_Placed]:
    """Placements with the first of others that differ from all before them."""
    together = list(kept)
    for one in found:
        if len(together) == max_count:
            break
        apart = [np.linalg.norm(one.points - other.points, axis=1).mean() for other in together]
        if min(apart, default=np.inf) > RIGID_PLACEMENTS.apart:
            together.append(one)
    return together


def _vote(tested: Floats, here: _Places, there: _Places) -> list[tuple[Floats, Floats]]:
    """Rotations and shifts with the most votes of pairs of places, each by the root of the product of their areas."""
    weights, goals = np.sqrt(np.outer(here.areas, there.areas)).ravel(), np.ascontiguousarray(there.points.T)
    found = []
    for rotation in tested:
        turned = here.move(rotation, np.zeros(3))
        # Flat numbers of pairs and rows of coordinates are gathered twice as fast as with two indices.
        pairs = np.flatnonzero(turned.normals @ there.normals.T > FACING)
        first, second = pairs // len(there.areas), pairs % len(there.areas)
        shifts = np.take(goals, second, axis=1) - np.take(turned.points.T, first, axis=1)
        cells = ((shifts - shifts.min(axis=1, keepdims=True, initial=np.inf)) / CELL).astype(np.int64)
        cell = np.ravel_multi_index(tuple(cells), tuple(cells.max(axis=1, initial=0) + 1))
        votes = np.bincount(cell, np.take(weights, pairs))
        for most in np.argsort(votes)[-CELLS_PER_ROTATION:]:
            if votes[most] > 0:
                found.append((float(votes[most]), rotation, shifts[:, cell == most].mean(axis=1)))
    found.sort(key=lambda one: one[0], reverse=True)
    return [(rotation, shift) for _, rotation, shift in found[: RIGID_PLACEMENTS.refined]]


def _refine(rotation: Floats, shift: Floats, here: _Places, there: _Places, tree: cKDTree) -> tuple[Floats, Floats]:
    """A rotation and shift after rigid ICP of places, which ignores those on cuts of the whole."""
    for _ in range(ROUNDS):
        placed = here.move(rotation, shift)
        near = tree.query(placed.with_normals())[1]
        distance = np.linalg.norm(placed.points - there.points[near], axis=1)
        agreement = np.einsum("dx,dx->d", placed.normals, there.normals[near])
        weight = here.areas * np.clip(agreement, 0, 1) / (1 + (distance / ROBUST_SCALE) ** 2) ** 2
        weight = weight * (there.cut_distance[near] > 0) + 1e-9
        step = procrustes(placed.points, there.points[near], weight, scales=(1.0, 1.0))
        rotation, shift = step.rotation @ rotation, step.rotation @ shift + step.translation
    return rotation, shift


def _rank(placed: _Places, there: _Places, tree: cKDTree) -> tuple[float, Integers]:
    """The cost of placed places, and (d_p,) the nearest places of the whole.

    Places of a fragment that are not near the other one must be beyond one of its cuts. The score combines, in both
    directions, the overlapping share of the remaining area and the overlapping area itself.
    """
    overlaps, beyond, places = _overlap(placed, there, tree)
    back, beyond_back, _ = _overlap(there, placed, cKDTree(placed.with_normals()))
    if np.count_nonzero(overlaps) < MIN_PLACES:
        return np.inf, places
    area, area_back = placed.areas @ overlaps, there.areas @ back
    share = area / (area + placed.areas @ ~(overlaps | beyond) + MIN_AREA)
    share_back = area_back / (area_back + there.areas @ ~(back | beyond_back) + MIN_AREA)
    return -float(np.log(share) + np.log(share_back + 1e-9) + 0.5 * np.log(area + MIN_AREA)), places


def _overlap(here: _Places, there: _Places, tree: cKDTree) -> tuple[Booleans, Booleans, Integers]:
    """(d,) which places overlap those of another shape, (d,) which are nearest to its cuts, (d,) the nearest ones."""
    near = np.asarray(tree.query(here.with_normals())[1])
    distance = np.linalg.norm(here.points - there.points[near], axis=1)
    agreement = np.einsum("dx,dx->d", here.normals, there.normals[near])
    nearest = np.asarray(cKDTree(there.points).query(here.points)[1])
    overlaps = np.asarray((distance < NEAR) & (agreement > AGREEING))
    return overlaps, np.asarray(there.cut_distance[nearest] < NEAR_CUT), near
