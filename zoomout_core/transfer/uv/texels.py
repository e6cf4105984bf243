# SPDX-License-Identifier: GPL-3.0-or-later
"""Texels of an atlas: those that an island owns, from which its image is interpolated, and those to be baked."""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.groups import find, first_of_each
from zoomout_core.transfer.pixels import INSIDE, pixels_near

# Maximum distance, in texels, of a place from the four texels that it is interpolated from.
REACH = 2**0.5

# (height, width, channels) of eight bits or of single precision, rows from top to bottom.
Pixels: TypeAlias = NDArray[Any]


class Islands:
    """The texels of an image that its islands own: those with their centre in an island.

    Made of the UVs (m, 3, 2) and islands (m,) of the triangles that refer to the image.
    """

    def __init__(self, uv: Floats, island: Integers, width: int, height: int) -> None:
        self._width, self._height = width, height
        # A triangle on which the image repeats is not bounded by texels.
        repeated = np.ptp(uv, axis=1).max(axis=1, initial=0) > 1
        self._endless = np.unique(island[repeated])
        bounded = np.flatnonzero(~repeated)
        owned = [np.empty(0, dtype=np.int64)]
        for x, y, triangle, _, distance in pixels_near(uv[bounded], width, height):
            inside = distance <= INSIDE
            owned.append(np.unique(self._key(x, y, island[bounded[triangle]])[inside]))
        self._owned = np.unique(np.concatenate(owned))

    def _key(self, x: Integers, y: Integers, island: Integers) -> Integers:
        """A unique number for a texel of an island."""
        return (island * self._height + y % self._height) * self._width + x % self._width

    def _own(self, x: Integers, y: Integers, island: Integers) -> Booleans:
        return np.asarray((find(self._owned, self._key(x, y, island)) >= 0) | np.isin(island, self._endless))

    def read(self, image: Pixels, uv: Floats, island: Integers) -> Floats:
        """(q, channels) values of the image at places (q, 2) of islands (q,), interpolated between their own texels."""
        at = uv * [self._width, self._height] - 0.5
        low = np.floor(at).astype(np.int64)
        part = at - low
        sums, total = np.zeros((len(uv), image.shape[2])), np.zeros(len(uv))
        for right in (0, 1):
            for up in (0, 1):
                x, y = low[:, 0] + right, low[:, 1] + up
                weight = np.abs(1 - right - part[:, 0]) * np.abs(1 - up - part[:, 1]) * self._own(x, y, island)
                sums += weight[:, None] * self._texels(image, x, y)
                total += weight
        lost = np.flatnonzero(total <= 0)
        sums[lost], total[lost] = self._texels(image, *self._nearest(uv[lost], island[lost])), 1
        return np.asarray(sums / total[:, None])

    def _nearest(self, uv: Floats, island: Integers) -> tuple[Integers, Integers]:
        """Columns and rows of the nearest own texels of places (q, 2) in islands, since tips are thinner than texels.

        An island that owns no texel takes the texel that contains the place.
        """
        at = uv * [self._width, self._height] % [self._width, self._height]
        texel = np.floor(at).astype(np.int64)
        if len(self._owned) and len(uv):
            own, tree = self._border
            distance, nearest = tree.query(np.column_stack([at, self._apart * island]))
            texel = np.where(np.asarray(distance < self._apart)[:, None], own[nearest], texel)
        return texel[:, 0], texel[:, 1]

    @property
    def _apart(self) -> float:
        """The distance between islands in the tree, so that others are never closer."""
        return 2.0 * (self._width + self._height)

    @cached_property
    def _border(self) -> tuple[Integers, cKDTree]:
        """(b, 2) columns and rows of own texels beside others, and their tree; the nearest own texel is among them."""
        number, place = np.divmod(self._owned, self._width * self._height)
        y, x = np.divmod(place, self._width)
        around = [self._own(x + right, y + up, number) for right, up in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        beside = ~np.logical_and.reduce(around)
        own = np.column_stack([x, y])[beside]
        return own, cKDTree(np.column_stack([own + 0.5, self._apart * number[beside]]))

    def _texels(self, image: Pixels, x: Integers, y: Integers) -> Pixels:
        return np.asarray(image[self._height - 1 - y % self._height, x % self._width])


def texels_of(uv: Floats, width: int, height: int) -> tuple[Integers, Integers, Floats]:
    """The texels of an image that triangles (m, 3, 2) cover or touch, and their places in these.

    Returns:
        (q,) numbers of texels, row after row from the bottom; (q,) the triangle that contains each, otherwise the
        nearest; and (q, 3) the place in it nearest to the texel's centre.
    """
    best = np.full(width * height, np.inf)
    triangle = np.full(width * height, -1)
    weights = np.zeros((width * height, 3))
    for x, y, candidate, place, distance in pixels_near(uv, width, height, REACH, window=True):
        chosen = np.flatnonzero(distance <= REACH)
        texel = y[chosen] * width + x[chosen]
        order = first_of_each(texel, distance[chosen])
        order = order[distance[chosen[order]] < best[texel[order]]]
        texel, chosen = texel[order], chosen[order]
        best[texel], triangle[texel], weights[texel] = distance[chosen], candidate[chosen], place[chosen]
    texel = np.flatnonzero(triangle >= 0)
    return texel, triangle[texel], weights[texel]
