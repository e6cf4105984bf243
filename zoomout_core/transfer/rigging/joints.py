# SPDX-License-Identifier: GPL-3.0-or-later
"""Joints of bones that belong to a worn object, such as those of skirts, ribbons and tails, moved along with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, to_floats
from zoomout_core.geometry.procrustes import SMALLEST, Similarities, procrustes
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.dressing.form import Lines

# Vertices that a joint follows: about the two nearest rings of a tube of ten sides. With three times as many, joints of
# skirts are twice as far from their places; with a third, noise of single vertices shows.
NEIGHBOURS = 20
# A joint follows all vertices within this multiple of its distance from the nearest one. The motion of a small patch
# cannot be extrapolated to a joint far from the surface, such as the pole target of a knee.
SPREAD = 2.0
# Standard deviation of the vertices' weights, as a share of the distance of the farthest one.
WIDTH = 0.5
# So that a ball contains the vertex that gave its radius.
ROUNDED_UP = 1 + 1e-9


class MovedJoints(NamedTuple):
    """Joints after a change of shape.

    Example:
        >>> zo.move_joints(source, source.vertices, [[0, 0, 0]]).rotations.shape
        (1, 3, 3)
    """

    positions: Floats  # (j, 3)
    rotations: Floats  # (j, 3, 3) rotations of their surroundings


def move_joints(worn: Surface | Lines, vertices: ArrayLike, joints: ArrayLike) -> MovedJoints:
    """Move joints along with a worn object whose vertices have moved, as `dress` moves them.

    Each joint moves by the similarity of the object's vertices around it, so that one inside a tail stays inside.

    Args:
        worn: the object before.
        vertices: (n, 3) its vertices after.
        joints: (j, 3) the joints before.

    Raises:
        ValueError: the vertices do not fit the object, or these or the joints are not finite.

    Example:
        >>> moved = zo.move_joints(source, source.vertices + [1, 0, 0], [[0, 0, 0]])
        >>> bool(abs(moved.positions - [1, 0, 0]).max() < 1e-6)
        True
    """
    after, places = to_floats(vertices, "Vertices"), finite_joints(joints)
    if after.shape != worn.vertices.shape or not np.isfinite(after).all():
        raise ValueError(
            f"vertices are of the shape {after.shape}, or not finite: give finite ones ({len(worn.vertices)}, 3)."
        )
    motions = motions_around(worn.vertices, after, places)
    return MovedJoints(motions(places[:, None])[:, 0], motions.rotation)


def finite_joints(joints: ArrayLike) -> Floats:
    """Joints as an array (j, 3).

    Raises:
        ValueError: they are not finite positions.
    """
    places = to_floats(joints, "Joints")
    if places.size % 3:
        raise ValueError(f"Joints are of the shape {places.shape}: give positions (j, 3).")
    places = places.reshape(-1, 3)
    if not np.isfinite(places).all():
        raise ValueError("Some joints are not finite: give finite positions (j, 3).")
    return places


def motions_around(before: Floats, after: Floats, places: Floats) -> Similarities:
    """(j,) the similarities of points (n, 3) around places (j, 3), from where they were to where they are."""
    tree = cKDTree(before)
    scale, rotation, translation = np.empty(len(places)), np.empty((len(places), 3, 3)), np.empty_like(places)
    for number, place in enumerate(places):
        nearest = np.asarray(tree.query(place, min(NEIGHBOURS, len(after)))[0])
        near = tree.query_ball_point(place, max(nearest.max(), SPREAD * nearest.min()) * ROUNDED_UP)
        distance = np.linalg.norm(before[near] - place, axis=1)
        width = max(WIDTH * distance.max(), SMALLEST)
        weights = np.exp((distance.min() ** 2 - distance**2) / (2 * width**2))
        motion = procrustes(before[near], after[near], weights)
        scale[number], rotation[number], translation[number] = motion.scale, motion.rotation, motion.translation
    return Similarities(scale, rotation, translation)
