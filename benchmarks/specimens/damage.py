# SPDX-License-Identifier: GPL-3.0-or-later
"""Damage clean specimens, whose truth is known, in the ways of burial, scanning and evolution.

Lengths are relative to the square root of a specimen's area.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals
from zoomout_core.spectral.sampling import farthest_points

# Share of the vertices that a break takes away, and that wear grinds down.
BROKEN, WORN = 0.1, 0.02
# How many landmarks holes and growths are at, and the radius of a hole.
PLACES, HOLE = 3, 0.04
# Height of a growth, and the standard deviation of its Gaussian.
HEIGHT, WIDTH = 0.06, 0.03
# Stretch of another species along the longest axis, how far it bends in the middle, and the length of the waves in it.
STRETCH, BEND, WAVES = 1.25, 0.08, 0.7


class Specimen(NamedTuple):
    """A surface with landmarks.

    Attributes:
        surface: the mesh.
        landmarks: (q, 3) where they are, or were.
        present: (q,) whether their places are still there.
    """

    surface: Surface
    landmarks: Floats
    present: Booleans


def intact(surface: Surface, landmarks: Floats) -> Specimen:
    """As it is."""
    return Specimen(surface, landmarks, np.ones(len(landmarks), dtype=bool))


def break_end(surface: Surface, landmarks: Floats) -> Specimen:
    """The end with the landmark that is farthest from the centre is broken off."""
    depth, of_landmarks = _depths(surface, landmarks, 1)
    edge = np.quantile(depth, 1 - BROKEN)
    return _without(surface, depth > edge, landmarks, of_landmarks < edge)


def wear_end(surface: Surface, landmarks: Floats) -> Specimen:
    """The end with the landmark that is second from the centre is ground down to a plane."""
    depth, of_landmarks = _depths(surface, landmarks, 2)
    edge = np.quantile(depth, 1 - WORN)
    flat = surface.vertices - np.maximum(depth - edge, 0)[:, None] * _axis(surface, landmarks, 2)
    return Specimen(surface.with_vertices(flat), landmarks, of_landmarks < edge)


def make_holes(surface: Surface, landmarks: Floats) -> Specimen:
    """Holes where some landmarks were."""
    radius = HOLE * np.sqrt(surface.area)
    centres = landmarks[farthest_points(landmarks, PLACES)]
    near = (np.linalg.norm(surface.vertices[:, None] - centres, axis=2) < radius).any(axis=1)
    left = np.linalg.norm(landmarks[:, None] - centres, axis=2).min(axis=1) >= radius
    return _without(surface, near, landmarks, left)


def grow_over(surface: Surface, landmarks: Floats) -> Specimen:
    """Growths, or matter that was left, over some landmarks: these stay where they were, below."""
    size = np.sqrt(surface.area)
    centres = landmarks[farthest_points(landmarks, 2 * PLACES)[PLACES:]]
    triangle, _ = closest_points(centres, surface.vertices, surface.triangles)
    normals = triangle_normals(surface.vertices, surface.triangles[triangle])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    squares = ((surface.vertices[:, None] - centres) ** 2).sum(axis=2) / size**2
    moved = surface.vertices + HEIGHT * size * np.exp(-squares / (2 * WIDTH**2)) @ normals
    return Specimen(surface.with_vertices(moved), landmarks, np.ones(len(landmarks), dtype=bool))


def another_species(surface: Surface, landmarks: Floats) -> Specimen:
    """Longer, narrower, bent and wavy, as a related species may be."""
    centre, size = surface.vertices.mean(axis=0), np.sqrt(surface.area)
    axes = np.linalg.svd(surface.vertices - centre, full_matrices=False)[2]

    def grow(points: Floats) -> Floats:
        along = (points - centre) @ axes.T / size * [STRETCH, STRETCH**-0.5, STRETCH**-0.5]
        along[:, 1] += BEND * np.cos(np.pi * along[:, 0])
        along += BEND / 4 * np.sin(2 * np.pi / WAVES * along[:, [1, 2, 0]])
        return np.asarray(centre + size * along @ axes)

    return intact(surface.with_vertices(grow(surface.vertices)), grow(landmarks))


def mirror_image(surface: Surface, landmarks: Floats) -> Specimen:
    """The bone of the other side of the body."""
    sign = np.array([-1.0, 1, 1])
    return intact(Surface(surface.vertices * sign, surface.triangles[:, ::-1]), landmarks * sign)


DAMAGES: dict[str, Callable[[Surface, Floats], Specimen]] = {
    "broken": break_end,
    "worn": wear_end,
    "holes": make_holes,
    "growths": grow_over,
    "other species": another_species,
}


def _axis(surface: Surface, landmarks: Floats, rank: int) -> Floats:
    """(3,) unit vector from the centre towards the landmark of a rank, 1 for the farthest one."""
    off = landmarks - surface.vertices.mean(axis=0)
    length = np.linalg.norm(off, axis=1)
    number = np.argsort(-length)[rank - 1]
    return np.asarray(off[number] / length[number])


def _depths(surface: Surface, landmarks: Floats, rank: int) -> tuple[Floats, Floats]:
    """(n,) and (q,) coordinates of vertices and landmarks along the axis of a rank."""
    axis = _axis(surface, landmarks, rank)
    return surface.vertices @ axis, landmarks @ axis


def _without(surface: Surface, gone: Booleans, landmarks: Floats, present: Booleans) -> Specimen:
    """A specimen without the triangles at some vertices (n,)."""
    return Specimen(
        Surface(surface.vertices, surface.triangles[~gone[surface.triangles].any(axis=1)]), landmarks, present
    )
