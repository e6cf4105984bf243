# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of previews and thumbnails that only Blender shows; the others are in `zoomout_core.colors`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from zoomout_core.colors import BAD_TO_GOOD, MET, confidence_colors, place_colors
from zoomout_core.geometry.closest_points import query_tree

if TYPE_CHECKING:
    from zoomout_core.arrays import Booleans, Floats, Integers
    from zoomout_core.symmetry.self_map import SelfMap

# Colours of the right side, the middle and the left side.
SIDES = BAD_TO_GOOD[1:]
# Fraction of white in the colours of the right side, so that the symmetry line shows.
PALENESS = 0.45
# Number of nearest samples whose colours are blended, weighted by the inverse squared distance.
BLENDED = 4
# Asymmetry that is shown in red by default: a length over the square root of the area, and a share of weights. It is
# the same for every check, so that colours improve as the mesh is repaired.
RED_LENGTH, RED_WEIGHT = 0.01, 0.1


def asymmetry_colors(values: Floats, max_value: float) -> Floats:
    """(n, 3) colours of differences (n,) between the sides: good at 0, bad from `max_value` on."""
    return confidence_colors(1 - values / max_value)


def blend_colors(points: Floats, known: Integers, colors: Floats) -> Floats:
    """(n, 3) colours of points (n, 3), blended by distance from the `colors` (s, 3) of the `known` ones (s,)."""
    found = query_tree(scipy.spatial.cKDTree(points[known]), np.nan_to_num(points), min(BLENDED, len(known)))
    distance, nearest = (array.reshape(len(points), -1) for array in found)
    weight = 1 / np.maximum(distance, 1e-30) ** 2
    return np.einsum("nk,nkc->nc", weight / weight.sum(axis=1, keepdims=True), colors[nearest])


def pair_colors(symmetry: SelfMap, order: int) -> Floats:
    """(n, 3) colours of a surface's vertices, the same throughout each orbit of a symmetry, and paler on the right.

    An orbit gets the colour of its largest coordinates along each axis.

    Args:
        symmetry: a symmetry of the surface.
        order: number of repetitions that give the identity, 0 if no small number does.
    """
    places = symmetry.surface.vertices
    farthest, image = places, places
    for _ in range(max(order, 2) - 1):
        image = symmetry.surface_map.interpolate(image)
        farthest = np.fmax(farthest, image)
    colors, right = place_colors(farthest, places), symmetry.distance[:, None] < 0
    return np.where(right, PALENESS + (1 - PALENESS) * colors, colors)


def side_colors(side: Integers) -> Floats:
    """(n, 3) colours of sides (n,): 1 is left, -1 right, 0 the middle."""
    return np.asarray(SIDES[side + 1])


def stretched_colors(stretched: Booleans) -> Floats:
    """(n, 3) colours of vertices (n,) that stretch, and of all others."""
    return np.where(stretched[:, None], BAD_TO_GOOD[0], MET)
