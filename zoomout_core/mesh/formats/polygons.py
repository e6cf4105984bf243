# SPDX-License-Identifier: GPL-3.0-or-later
"""Polygons as arrays, as readers return them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats, Integers

# Positions (n, 3), the vertex of each corner (c,), and the number of corners of each face (f,).
Faces = tuple[Floats, Integers, Integers]
# The same with the first corner of each face, and the number of corners (f + 1,).
Polygons = tuple[Floats, Integers, Integers]


def join(parts: Iterable[Faces]) -> Polygons:
    """Join meshes into one."""
    found = list(parts)
    count = np.cumsum([0, *(len(points) for points, _, _ in found)])
    corners = [each + first for (_, each, _), first in zip(found, count, strict=False)]
    points = np.concatenate([np.zeros((0, 3)), *(each for each, _, _ in found)])
    return points, concatenate(corners), starts([sizes for _, _, sizes in found])


def reverse_winding(corners: Integers, sizes: Integers) -> Integers:
    """(c,) corners, reversed within each face; the sizes (f,) are the numbers of corners of the faces."""
    start = np.cumsum(sizes) - sizes
    place = np.arange(len(corners)) - np.repeat(start, sizes)
    return np.asarray(corners[np.repeat(start + sizes - 1, sizes) - place])


def starts(sizes: Sequence[Any]) -> Integers:
    """(f + 1,) the first corner of each face, and the number of corners, from arrays of numbers of corners."""
    return np.concatenate([[0], np.cumsum(concatenate(sizes))])


def concatenate(arrays: Sequence[Any]) -> Integers:
    """Arrays of integers (c_i,) as one, which may be empty."""
    return np.concatenate([np.zeros(0, dtype=np.int64), *arrays]).astype(np.int64)
