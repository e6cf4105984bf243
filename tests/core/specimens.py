# SPDX-License-Identifier: GPL-3.0-or-later
"""Hollow bodies that a smooth deformation of space turns into each other."""

from __future__ import annotations

import numpy as np
from creatures import creature
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals

# Thickness of the wall; the bodies are about two units large.
WALL = 0.06


def hollow(count: int, seed: int) -> Surface:
    """A creature with an inner wall: the outer surface's vertices come first."""
    outer = creature(count, seed, asymmetry=0.3).surface
    inner = outer.vertices - WALL * vertex_normals(outer.vertices, outer.triangles)
    return Surface.joined([outer, Surface(inner, outer.triangles[:, ::-1])])


def grow(points: Floats) -> Floats:
    """The points (n, 3) of one specimen on the other one."""
    bent = points + 0.06 * np.sin(2 * points[:, [1, 2, 0]] + [0.3, 0, 0.5]) * [1, -1, 1]
    return 1.2 * Rotation.from_rotvec([0.4, -0.9, 0.2]).apply(bent) + [3, -1, 2]
