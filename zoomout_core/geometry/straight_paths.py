# SPDX-License-Identifier: GPL-3.0-or-later
"""Straight paths over a triangle mesh.

A path crosses each triangle along a line, and continues straight when the next triangle is unfolded into the plane:
Polthier and Schmies, Straightest geodesics on polyhedral surfaces (1998). A point therefore stays on its side of a thin
gap, such as the one between two lips. The closest point in space may be on the other side.
"""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import cross, sides_by_edge, unit_vectors

# Maximum number of triangles on a path. Paths around a vertex cross many, and rounding may send one back and forth.
MAX_CROSSED = 1000


def follow_paths(
    vertices: Floats, triangles: Integers, triangle: Integers, barycentric: Floats, steps: Floats
) -> tuple[Integers, Floats]:
    """Move points over a mesh of triangles (m, 3) on vertices (n, 3).

    Args:
        vertices: positions.
        triangles: vertex numbers, wound in any way.
        triangle: (q,) the triangles that the points are in.
        barycentric: (q, 3) their barycentric coordinates there.
        steps: (q, 3) the displacements. In each triangle only their part along it counts.

    Returns:
        (q,) and (q, 3) the triangles and coordinates of the ends. A path that meets a border slides along it, also
        where more than two triangles meet.
    """
    triangle, barycentric, left = triangle.copy(), barycentric.copy(), steps.copy()
    across = _neighbours(triangles)
    moving = np.arange(len(triangle))
    entry = np.zeros((len(triangle), 3), dtype=bool)
    for _ in range(MAX_CROSSED):
        here, weights = triangle[moving], barycentric[moving]
        rates = _rates(vertices[triangles[here]], left[moving])
        # The shares of the steps at which they reach the lines through the triangles' sides.
        with np.errstate(over="ignore"):  # a side that is reached after a share beyond the largest float is not reached
            shares = np.divide(weights, -rates, out=np.full_like(rates, np.inf), where=(rates < 0) & ~entry)
        share = shares.min(axis=1)
        # From a vertex, the path first turns about it until it leads into a triangle: the shorter way round.
        first = (shares == share[:, None]) * np.where(across[here] >= 0, 2, 1)
        opposite = np.where(first == first.max(axis=1, keepdims=True), rates, np.inf).argmin(axis=1)
        barycentric[moving] = _normalise(weights + np.minimum(share, 1)[:, None] * rates)
        leaving = np.flatnonzero(share < 1)
        if not len(leaving):
            break
        moving, here, opposite = moving[leaving], here[leaving], opposite[leaving]
        left[moving] *= (1 - share[leaving])[:, None]
        following = across[here, opposite]
        corners = vertices[_turn_to(triangles[here], opposite)]
        # No straight path leaves a triangle by the side that it came through, or along which it slides.
        entry = np.arange(3) == opposite[:, None]
        along = unit_vectors(corners[:, 2] - corners[:, 1])
        slid = np.einsum("qx,qx->q", left[moving], along)[:, None] * along
        crossing = following >= 0
        left[moving[~crossing]] = slid[~crossing]
        here, following, over = here[crossing], following[crossing], moving[crossing]
        shared = triangles[following][:, :, None] == triangles[here][:, None]
        barycentric[over] = _normalise(np.einsum("qij,qj->qi", shared, barycentric[over]))
        entry[crossing] = ~shared.any(axis=2)
        beyond = vertices[triangles[following, entry[crossing].argmax(axis=1)]]
        left[over] = _unfold(left[over], corners[crossing], beyond)
        triangle[over] = following
    return triangle, barycentric


def _neighbours(triangles: Integers) -> Integers:
    """(m, 3) the triangle across the side opposite to each corner; -1 at borders and where more than two meet."""
    side, first = sides_by_edge(triangles)
    pairs = first[:-1][np.diff(first) == 2]
    one, other = side[pairs], side[pairs + 1]
    across = np.full(triangles.size, -1)
    across[one], across[other] = other // 3, one // 3
    # The side from the second corner to the third is opposite to the first.
    return np.roll(across.reshape(-1, 3), -1, axis=1)


def _rates(corners: Floats, steps: Floats) -> Floats:
    """(q, 3) changes of barycentric coordinates in triangles with corners (q, 3, 3) by steps (q, 3)."""
    a, b, c = corners.transpose(1, 0, 2)
    normal = cross(b - a, c - a)
    squared = np.einsum("qx,qx->q", normal, normal)[:, None]
    rates = np.stack([np.einsum("qx,qx->q", cross(normal, edge), steps) for edge in (c - b, a - c, b - a)], axis=1)
    return np.divide(rates, squared, out=np.zeros_like(rates), where=squared > 0)


def _normalise(weights: Floats) -> Floats:
    """Barycentric coordinates (q, 3) without the rounding below zero."""
    weights = np.maximum(weights, 0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _turn_to(corners: Integers, first: Integers) -> Integers:
    """(q, 3) corners in the same cyclic order, beginning with the given ones (q,)."""
    return np.take_along_axis(corners, (first[:, None] + np.arange(3)) % 3, axis=1)


def _unfold(steps: Floats, triangle: Floats, beyond: Floats) -> Floats:
    """Steps (q, 3) from triangles (q, 3, 3) over the sides opposite to their first corners, to corners (q, 3)."""
    within, start, end = triangle.transpose(1, 0, 2)
    along = unit_vectors(end - start)
    inwards, onwards = (
        unit_vectors(away - np.einsum("qx,qx->q", away, along)[:, None] * along)
        for away in (within - start, beyond - start)
    )
    kept, into = (np.einsum("qx,qx->q", steps, each)[:, None] for each in (along, inwards))
    return np.asarray(kept * along - into * onwards)
