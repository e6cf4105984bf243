# SPDX-License-Identifier: GPL-3.0-or-later
"""Flip some edges of a mesh: the same vertices, other triangles, and nearly the same surface."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, unique_edges


def with_flipped_edges(surface: Surface, share: float, seed: int) -> Surface:
    """Flip a random share of the edges of a triangle mesh, each to the two vertices opposite to it.

    An edge stays if it is not between two triangles, if its opposite vertices are already connected, or if its flip
    would fold the surface over.

    Args:
        surface: the mesh; its winding should be consistent.
        share: of all edges, in [0, 1]; fewer are flipped where fewer can be.
        seed: of the choice.
    """
    vertices, triangles = surface.vertices, surface.triangles.copy()
    # The triangle of each directed edge.
    sides = {(int(t[i]), int(t[i - 2])): number for number, t in enumerate(triangles) for i in range(3)}
    edges, _ = unique_edges(triangles)
    left = round(share * len(edges))
    for a, b in np.random.default_rng(seed).permutation(edges).tolist():
        if left == 0:
            break
        if (a, b) not in sides or (b, a) not in sides:
            continue
        two = sides[a, b], sides[b, a]
        c, d = (int(triangles[number].sum()) - a - b for number in two)
        flipped: Integers = np.array([[c, a, d], [d, b, c]])
        if (c, d) in sides or (d, c) in sides or _folds(vertices, triangles[list(two)], flipped):
            continue
        triangles[list(two)] = flipped
        del sides[a, b], sides[b, a]
        sides |= {(d, c): two[0], (a, d): two[0], (c, d): two[1], (b, c): two[1]}
        left -= 1
    return Surface(vertices, triangles)


def _folds(vertices: Floats, before: Integers, after: Integers) -> bool:
    """Whether one of two triangles (2, 3) after a flip does not face where both faced before."""
    faced = area_normals(vertices, before).sum(axis=0)
    return bool((area_normals(vertices, after) @ faced <= 0).any())
