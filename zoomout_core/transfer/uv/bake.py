# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture baking: read the source's images into the target's own atlas, texel by texel along the map.

A texel of the target's atlas is a place on the target, which maps to one island of the source's atlas. There the image
is interpolated between the four nearest texels. Texels that other islands or no island own do not count, so nothing
beyond a seam shows. A texel that an island of the target only touches is read at the island's nearest point. All other
texels, the gutters, take the value of the nearest texel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Bytes, Floats, Integers, check_counts
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.progress import advance, stage
from zoomout_core.transfer.groups import find, first_of_each
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.pixels import INSIDE, pixels_near
from zoomout_core.transfer.uv.chart import chart_of

# Texels that are read together; bounds the memory.
READ_TOGETHER = 1 << 15
# Maximum distance, in texels, of a place from the four texels that it is interpolated from.
REACH = 2**0.5


@dataclass(frozen=True, eq=False)
class Picture:
    """The images that an atlas refers to."""

    images: Sequence[Bytes]  # each (height, width, channels), rows from top to bottom, with equal numbers of channels
    number: Integers  # (m,) the image of each triangle


@dataclass(frozen=True, eq=False)
class Baked:
    """An image for the target's atlas."""

    image: Bytes  # (height, width, channels), rows from top to bottom
    covered: Booleans  # (height, width) the texels that triangles of the target cover or touch; the others are gutters
    outside: Booleans  # (m_t,) triangles of the target that are outside of the image, wholly or in part


def bake(
    mapped: MappedTarget, source_uv: Floats, picture: Picture, target_uv: Floats, width: int, height: int
) -> Baked:
    """Bake the source's images into the target's atlas.

    Args:
        mapped: the target on the source.
        source_uv: (c_s, 2) UVs at the source's corners; images repeat beyond the unit square.
        picture: the source's images.
        target_uv: (c_t, 2) UVs at the target's corners; areas beyond the unit square are not baked.
        width: width of the new image, in texels.
        height: height of the new image, in texels.

    Raises:
        MeshError: no texel of the image is in the target's atlas.
        ValueError: the width or height is below one.
    """
    check_counts(width=width, height=height)
    source, target = mapped.source, mapped.target
    islands = chart_of(source, source_uv).cut.triangle_island
    corners = source_uv[source.triangle_corners]  # (m_s, 3, 2)
    owned = []
    with stage("Reading the islands of the source", 0.0, 0.2):
        for number, image in enumerate(picture.images):
            advance(number / len(picture.images))
            chosen = np.flatnonzero(picture.number == number)
            owned.append(_Islands(corners[chosen], islands[chosen], *image.shape[1::-1]))
    with stage("Looking for texels", 0.2, 0.3):
        atlas = target_uv[target.triangle_corners]
        texel, triangle, weights = _texels_of(atlas, width, height)
    if not len(texel):
        raise MeshError(
            "The target's texture coordinates cover no texel of the image: place them in the unit square, or use a "
            "larger image."
        )
    values = np.empty((len(texel), picture.images[0].shape[2]), dtype=np.uint8)
    with stage("Baking", 0.3, 0.9):
        for first in range(0, len(texel), READ_TOGETHER):
            advance(first / len(texel))
            block = slice(first, first + READ_TOGETHER)
            place, inside = mapped.locate(triangle[block], weights[block])
            uv = np.einsum("qc,qcx->qx", inside, corners[place])
            for number in np.unique(picture.number[place]):
                here = picture.number[place] == number
                values[block][here] = owned[number].read(picture.images[number], uv[here], islands[place[here]])
    with stage("Filling gutters", 0.9, 1.0):
        covered = np.zeros((height, width), dtype=bool)
        image = np.zeros((height, width, values.shape[1]), dtype=np.uint8)
        row, column = height - 1 - texel // width, texel % width
        covered[row, column], image[row, column] = True, values
        nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    outside = ~((atlas >= -INSIDE) & (atlas <= 1 + INSIDE)).all(axis=(1, 2))
    return Baked(image[tuple(nearest)], covered, outside)


class _Islands:
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

    def read(self, image: Bytes, uv: Floats, island: Integers) -> Bytes:
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
        return np.rint(sums / total[:, None]).astype(np.uint8)

    def _nearest(self, uv: Floats, island: Integers) -> tuple[Integers, Integers]:
        """Columns and rows of the nearest own texels of places (q, 2) in islands, since tips are thinner than texels.

        An island that owns no texel takes the texel that contains the place.
        """
        at = uv * [self._width, self._height] % [self._width, self._height]
        texel = np.floor(at).astype(np.int64)
        if len(self._owned) and len(uv):
            apart = 2.0 * (self._width + self._height)  # so that other islands are never closer
            number, place = np.divmod(self._owned, self._width * self._height)
            own = np.column_stack([place % self._width, place // self._width])
            tree = cKDTree(np.column_stack([own + 0.5, apart * number]))
            distance, nearest = tree.query(np.column_stack([at, apart * island]))
            texel = np.where(np.asarray(distance < apart)[:, None], own[nearest], texel)
        return texel[:, 0], texel[:, 1]

    def _texels(self, image: Bytes, x: Integers, y: Integers) -> Bytes:
        return np.asarray(image[self._height - 1 - y % self._height, x % self._width])


def _texels_of(uv: Floats, width: int, height: int) -> tuple[Integers, Integers, Floats]:
    """The texels of an image that triangles (m, 3, 2) cover or touch, and their places in these.

    Returns:
        (q,) numbers of texels, row after row from the bottom; (q,) the triangle that contains each, or else the
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
