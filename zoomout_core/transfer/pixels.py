# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels of an image triangles cover or touch, and where in these."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import barycentric_of_closest, inner_products
from zoomout_core.transfer.groups import expand_ranges

# Pairs of a pixel and a triangle tested together; bounds the memory.
BLOCK = 1 << 19
# A pixel is in a triangle if its centre is within this rounding error of it.
INSIDE = 1e-6


def pixels_near(
    corners: Floats, width: int, height: int, reach: float = 0.0, window: bool = False
) -> Iterator[tuple[Integers, Integers, Integers, Floats, Floats]]:
    """Pixels within reach of triangles, and some more, in blocks.

    Args:
        corners: (m, 3, 2) the triangles; the image is the unit square.
        width: width of the image, in pixels.
        height: its height.
        reach: distance from a triangle, in pixels.
        window: whether only pixels of the image are wanted, and none beyond.

    Yields:
        (q,) columns and (q,) rows from the bottom; (q,) triangles, (q, 3) barycentric coordinates of the place nearest
        to the pixel's centre, and (q,) its distance, in pixels.
    """
    size = np.array([width, height])
    places = corners * size
    low = np.ceil(places.min(axis=1) - 0.5 - reach)
    high = np.floor(places.max(axis=1) - 0.5 + reach)
    if window:
        low, high = np.maximum(low, 0), np.minimum(high, size - 1)
    first = low.astype(np.int64)
    columns, rows = np.maximum(high - low + 1, 0).astype(np.int64).T
    row_triangle, row = expand_ranges(first[:, 1], first[:, 1] + rows)
    ends = np.cumsum(columns[row_triangle])
    for block in np.split(np.arange(len(ends)), np.flatnonzero(np.diff(ends // BLOCK)) + 1):
        start = first[row_triangle[block], 0]
        owner, x = expand_ranges(start, start + columns[row_triangle[block]])
        triangle, y = row_triangle[block][owner], row[block][owner]
        a, b, c = places[triangle].transpose(1, 2, 0)
        ab, ac, offset = b - a, c - a, np.stack([x, y]) + 0.5 - a
        weights = barycentric_of_closest(inner_products(offset, ab, ac, axis=0))
        offset -= weights[:, 1] * ab + weights[:, 2] * ac
        yield x, y, triangle, weights, np.hypot(*offset)
