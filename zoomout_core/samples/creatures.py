# SPDX-License-Identifier: GPL-3.0-or-later
"""Creatures with known correspondence, in any pose and with any triangles.

A creature is a sphere with limbs pulled out of it, as a function of the direction from its centre. Every choice of
directions is another mesh of the same surface, and equal directions are the same place. A pose bends the limbs, which
nearly preserves distances along the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.arcs import bend_along_arc
from zoomout_core.samples.spheres import directions, outward_hull

# Directions, lengths and sharpness of the limbs; x is the creature's left, -y its front, z points up.
NAMES = ("Arm.L", "Arm.R", "Leg.L", "Leg.R", "Head", "Tail")
LIMBS = np.array([[1, 0.1, 0.35], [-1, 0.1, 0.35], [0.45, 0, -1], [-0.45, 0, -1], [0, 0.05, 1], [0, 1, -0.25]])
LENGTHS = np.array([2.6, 2.6, 3.2, 3.2, 0.8, 2.0])
SHARPNESS = np.array([70.0, 70.0, 70.0, 70.0, 9.0, 90.0])
# Scale of the body along each axis: flattened from front to back.
FLAT = np.array([1, 0.7, 1])
# Distance from the centre at which limbs begin to bend.
BODY = 1.05
# Distances beyond the body at which a limb begins to move with its joint, and moves only with it.
LIMB_BEGINS, LIMB_IS_FREE = 0.1, 1.0


@dataclass(frozen=True)
class Creature:
    """A mesh with the direction (n, 3) of each vertex."""

    surface: Surface
    directions: Floats


def creature(
    count: int = 4000, seed: int = 0, bend: float = 0.0, asymmetry: float = 0.0, without: int | None = None
) -> Creature:
    """A creature with two arms, two legs, a head and a tail.

    Args:
        count: number of vertices.
        seed: seed of the mesh; the surface is the same for every seed.
        bend: bend of the limbs, in radians from body to tip.
        asymmetry: how much longer the left limbs are than the right ones.
        without: the number of a limb that it lacks.
    """
    where = directions(count, seed)
    lengths = LENGTHS * (1 + asymmetry * np.sign(LIMBS[:, 0])) * (np.arange(len(LIMBS)) != without)
    return Creature(Surface(posed(at_rest(where, lengths), bend), outward_hull(where)), where)


def at_rest(where: Floats, lengths: Floats = LENGTHS) -> Floats:
    """(n, 3) points in directions (n, 3), with limbs of some lengths."""
    return where * (1 + _shapes(where) @ lengths)[:, None] * FLAT


def limb_heights(where: Floats) -> Floats:
    """(n, limbs) how far each limb pulls out points in directions (n, 3)."""
    return LENGTHS * _shapes(where)


def _shapes(where: Floats) -> Floats:
    """(n, limbs) how far each limb pulls out points in directions (n, 3), as shares of its length."""
    return np.exp(SHARPNESS * (where @ (LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True)).T - 1))


def limb_weights(where: Floats) -> Floats:
    """(n, 1 + limbs) weights of the body and each limb at directions (n, 3); rows sum to one."""
    limbs = np.clip((limb_heights(where) - LIMB_BEGINS) / (LIMB_IS_FREE - LIMB_BEGINS), 0, 1)
    return np.column_stack([1 - limbs.sum(axis=1), limbs])


def true_vertex(source: Creature, target: Creature) -> Integers:
    """(n_t,) the source vertex at, or nearest to, each target vertex's place."""
    return np.asarray(cKDTree(source.directions).query(target.directions)[1])


def posed(points: Floats, bend: float) -> Floats:
    """Points (n, 3) with the limbs bent along arcs, by some radians: arms upwards, legs forwards, the tail down."""
    points = points.copy()
    if bend == 0:
        return points
    for along, towards, sign in ((0, 2, 1), (0, 2, -1), (2, 1, -1), (1, 2, 1)):
        beyond = sign * points[:, along] - BODY
        moved_here = beyond > 0
        across = points[moved_here, towards]
        radius = beyond.max() / bend
        outwards, points[moved_here, towards] = bend_along_arc(
            across, beyond[moved_here] / radius, radius, across.mean()
        )
        points[moved_here, along] = sign * (BODY + outwards)
    return points
