"""Generated creatures whose true correspondence is known, whatever their pose and their topology.

A creature is a sphere with limbs drawn out of it, given as a function of the direction from its centre. Every
choice of directions is another mesh of the same surface, and the same direction is the same place. A pose
bends the limbs, which leaves distances along the surface nearly as they were.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from zoomout_core.mesh.surface import Surface

# Directions, lengths and sharpness of the limbs; x is the creature's left. Two arms, two legs, head, tail.
LIMBS = np.array([[1, 0.1, 0.35], [-1, 0.1, 0.35], [0.45, 0, -1], [-0.45, 0, -1], [0, 0.05, 1], [0, 1, -0.25]])
LENGTHS = np.array([2.6, 2.6, 3.2, 3.2, 0.8, 2.0])
SHARPNESS = np.array([70.0, 70.0, 70.0, 70.0, 9.0, 90.0])
# Where limbs begin to bend, from the centre.
BODY = 1.05


@dataclass(frozen=True)
class Creature:
    """A mesh with the direction (n, 3) that each vertex stands for."""

    surface: Surface
    directions: np.ndarray


def directions(count: int, seed: int) -> np.ndarray:
    """(count, 3) irregular but even points on the sphere."""
    i = np.arange(count) + 0.5
    height, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    ring = np.sqrt(1 - height**2)
    points = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    random = np.random.default_rng(seed)
    points = points @ np.linalg.qr(random.standard_normal((3, 3)))[0]
    points += random.normal(scale=0.25 / np.sqrt(count), size=points.shape)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def creature(
    count: int = 4000, seed: int = 0, bend: float = 0.0, asymmetry: float = 0.0, without: int | None = None
) -> Creature:
    """A creature with two arms, two legs, a head and a tail.

    Args:
        count: of vertices.
        seed: of the mesh; the surface is the same for every seed.
        bend: of the limbs, in radians from body to tip.
        asymmetry: how much longer the left limbs are than the right ones.
        without: the number of a limb that it lacks.
    """
    where = directions(count, seed)
    axes = LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True)
    lengths = LENGTHS * (1 + asymmetry * np.sign(axes[:, 0])) * (np.arange(len(LIMBS)) != without)
    radius = 1 + np.exp(SHARPNESS * (where @ axes.T - 1)) @ lengths
    triangles = ConvexHull(where).simplices
    a, b, c = (where[triangles[:, i]] for i in range(3))
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) > 0
    triangles = np.where(outward[:, None], triangles, triangles[:, ::-1])
    return Creature(Surface(_posed(where * radius[:, None] * [1, 0.7, 1], bend), triangles), where)


def on_limb(made: Creature, limb: int) -> np.ndarray:
    """(n,) whether a vertex's place stands out by the limb of that number, where the creature has it."""
    axis = LIMBS[limb] / np.linalg.norm(LIMBS[limb])
    return np.asarray(LENGTHS[limb] * np.exp(SHARPNESS[limb] * (made.directions @ axis - 1)) > 0.3)


def true_vertex(source: Creature, target: Creature) -> np.ndarray:
    """(n_t,) the source vertex at, or nearest to, each target vertex's place."""
    return np.asarray(cKDTree(source.directions).query(target.directions)[1])


def mirrored_vertex(source: Creature, target: Creature) -> np.ndarray:
    """The same with left and right exchanged."""
    return np.asarray(cKDTree(source.directions).query(target.directions * [-1, 1, 1])[1])


def _posed(points: np.ndarray, bend: float) -> np.ndarray:
    """Bend what lies beyond the body around arcs: arms upwards, legs forwards, the tail down."""
    points = points.copy()
    if bend == 0:
        return points
    for along, towards, sign in ((0, 2, 1), (0, 2, -1), (2, 1, -1), (1, 2, 1)):
        beyond = sign * points[:, along] - BODY
        moved = beyond > 0
        # The limb's middle line becomes an arc of constant curvature; sections stay plane.
        middle = points[moved, towards].mean()
        radius = beyond.max() / bend
        angle = beyond[moved] / radius
        across = points[moved, towards] - middle
        points[moved, along] = sign * (BODY + (radius - across) * np.sin(angle))
        points[moved, towards] = middle + radius - (radius - across) * np.cos(angle)
    return points
