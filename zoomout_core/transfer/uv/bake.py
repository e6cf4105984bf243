# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture baking: read the source's images into the target's own atlas, texel by texel along the map.

A texel of the target's atlas is a place on the target, which maps to one island of the source's atlas. There each image
is interpolated between the four nearest texels. Texels that other islands or no island own do not count, so nothing
beyond a seam shows. A texel that an island of the target only touches is read at the island's nearest point. All other
texels, the gutters, take the value of the nearest texel.

Normals are read in the tangent space of the source, rotated with the surface, and written in that of the target.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers, check_counts
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.runtime.progress import advance, portion, stage
from zoomout_core.transfer.attribute import Domain
from zoomout_core.transfer.frames import rotations
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.pixels import INSIDE
from zoomout_core.transfer.uv.chart import chart_of
from zoomout_core.transfer.uv.tangents import TangentSpace, tangent_space
from zoomout_core.transfer.uv.texels import Islands, Pixels, texels_of

# Texels that are read together, and those of a band of rows; they bound the memory.
READ_TOGETHER = 1 << 15
BAND = 1 << 22
# Volume of a tangent space, of unit vectors, below which it has collapsed.
MIN_VOLUME = 1e-6


@dataclass(frozen=True, eq=False)
class Picture:
    """Images of one role, such as the base color, on a source of m triangles and c corners."""

    images: Sequence[Pixels]  # with equal numbers of channels, all of eight bits or all of single precision
    number: Integers  # (m,) the image of each triangle, -1 for none
    uv: Floats  # (c, 2) UVs; images repeat beyond the unit square
    normals: bool = False  # whether the first three channels are normals in tangent space


@dataclass(frozen=True, eq=False)
class CornerNormals:
    """The normals that normal maps refer to."""

    source: Floats  # (c_s, 3) unit normals of the source's corners
    target: Floats  # (c_t, 3) those of the target's
    relief: bool = False  # whether to include relief of the source that the target's mesh lacks


@dataclass(frozen=True, eq=False)
class Baked:
    """Images for the target's atlas."""

    images: list[Pixels | None]  # of each picture; None if no texel maps to any of its images
    covered: Booleans  # (height, width) the texels that triangles of the target cover or touch; the others are gutters
    outside: Booleans  # (m_t,) triangles of the target that are outside of the image, wholly or in part


def bake(
    mapped: MappedTarget,
    pictures: Sequence[Picture],
    target_uv: Floats,
    width: int,
    height: int,
    normals: CornerNormals | None = None,
) -> Baked:
    """Bake the source's images into the target's atlas.

    Args:
        mapped: the target on the source.
        pictures: the source's images.
        target_uv: (c_t, 2) UVs at the target's corners; areas beyond the unit square are not baked.
        width: width of the new images, in texels.
        height: height of the new images, in texels.
        normals: for pictures of normals, the normals of both surfaces.

    Raises:
        MeshError: no texel of the image is in the target's atlas.
        ValueError: the width or height is below one, or normals are missing.
    """
    check_counts(width=width, height=height)
    if normals is None and any(picture.normals for picture in pictures):
        raise ValueError("normals is None: give those of both surfaces, to bake pictures of normals.")
    readers = list[_Reader]()
    with stage("Reading the islands of the source", 0.0, 0.2):
        for number, picture in enumerate(pictures):
            with portion(number / len(pictures), (number + 1) / len(pictures)):
                readers.append(_Reader(mapped, picture))
    turns = [
        _Turn.of(mapped, picture.uv, target_uv, normals) if picture.normals and normals else None
        for picture in pictures
    ]
    canvases = [_Canvas(reader, turn, width, height) for reader, turn in zip(readers, turns, strict=True)]
    atlas = target_uv[mapped.target.triangle_corners]
    covered = np.zeros((height, width), dtype=bool)
    with stage("Baking", 0.2, 0.9):
        for row, column, triangle, weights in _blocks(atlas, width, height):
            covered[row, column] = True
            place, inside = mapped.locate(triangle, weights)
            for canvas in canvases:
                chosen = canvas.picture.number[place] >= 0
                canvas.paint(
                    row[chosen], column[chosen], place[chosen], inside[chosen], triangle[chosen], weights[chosen]
                )
    if not covered.any():
        raise MeshError(
            "The target's texture coordinates cover no texel of the image: place them in the unit square, or use a "
            "larger image."
        )
    outside = ~((atlas >= -INSIDE) & (atlas <= 1 + INSIDE)).all(axis=(1, 2))
    with stage("Filling gutters", 0.9, 1.0):
        return Baked(_fill(canvases), covered, outside)


def tiles_of(surface: Surface, uv: Floats) -> Integers:
    """(m, 2) the UDIM tile, as its column and row, that contains the centre of each triangle, by UVs (c, 2)."""
    return np.asarray(np.floor(uv[surface.triangle_corners].mean(axis=1)), dtype=np.int64)


class _Reader:
    """Reads a picture at places of the source."""

    def __init__(self, mapped: MappedTarget, picture: Picture) -> None:
        self.picture = picture
        self._island = chart_of(mapped.source, picture.uv).cut.triangle_island
        self._corners = picture.uv[mapped.source.triangle_corners]  # (m, 3, 2)
        self._islands = list[Islands]()
        for number, image in enumerate(picture.images):
            advance(number / len(picture.images))
            chosen = np.flatnonzero(picture.number == number)
            self._islands.append(Islands(self._corners[chosen], self._island[chosen], *image.shape[1::-1]))

    def read(self, triangle: Integers, barycentric: Floats) -> Floats:
        """(q, channels) values at points (q, 3) of triangles (q,) that have an image."""
        picture = self.picture
        values = np.empty((len(triangle), picture.images[0].shape[2]))
        uv = np.einsum("qc,qcx->qx", barycentric, self._corners[triangle])
        for number in np.unique(picture.number[triangle]):
            here = picture.number[triangle] == number
            values[here] = self._islands[number].read(picture.images[number], uv[here], self._island[triangle[here]])
        return values


@dataclass(frozen=True, eq=False)
class _Turn:
    """Takes normals from the tangent space of the source to that of the target."""

    source: TangentSpace
    target: TangentSpace
    triangles: Integers  # (m_t, 3) the target's
    rotations: Floats  # (n_t, 3, 3) from the source to the target
    relief: bool

    @classmethod
    def of(cls, mapped: MappedTarget, source_uv: Floats, target_uv: Floats, normals: CornerNormals) -> _Turn:
        return cls(
            tangent_space(mapped.source, source_uv, normals.source),
            tangent_space(mapped.target, target_uv, normals.target),
            mapped.target.triangles,
            rotations(mapped, Domain.POINT),
            normals.relief,
        )

    def rotate(self, normals: Floats, place: Integers, inside: Floats, triangle: Integers, weights: Floats) -> Floats:
        """(q, 3) unit normals in the target's tangent space.

        Args:
            normals: (q, 3) normals in the source's tangent space.
            place: (q,) triangles of the source.
            inside: (q, 3) the points in these.
            triangle: (q,) triangles of the target.
            weights: (q, 3) the points in these.
        """
        there, here = self.source.at(place, inside), self.target.at(triangle, weights)
        rotation = np.einsum("qc,qcxy->qxy", weights, self.rotations[self.triangles[triangle]])
        turned = np.einsum("qxy,qyz,qz->qx", rotation, there, normals, optimize=True)
        if not self.relief:
            smooth = unit_vectors(np.einsum("qxy,qy->qx", rotation, there[:, :, 2]))
            turned = _turn_between(turned, smooth, unit_vectors(here[:, :, 2]))
        flat = np.abs(np.linalg.det(here)) < MIN_VOLUME
        here[flat], turned[flat] = np.eye(3), [0, 0, 1]
        return unit_vectors(np.linalg.solve(here, turned[:, :, None])[:, :, 0])


class _Canvas:
    """A new image of the target, painted with a picture of the source.

    Args:
        reader: reads the picture.
        turn: rotates the normals that the picture has; None if it has colours.
        width: width of the image, in texels.
        height: its height.
    """

    def __init__(self, reader: _Reader, turn: _Turn | None, width: int, height: int) -> None:
        self.picture, self._reader, self._turn = reader.picture, reader, turn
        sample = self.picture.images[0]
        self.image: Pixels = np.zeros((height, width, sample.shape[2]), sample.dtype)
        self.has_value = np.zeros((height, width), dtype=bool)

    def paint(
        self,
        row: Integers,
        column: Integers,
        place: Integers,  # (q,) triangles of the source
        inside: Floats,  # (q, 3) the points in these
        triangle: Integers,  # (q,) triangles of the target
        weights: Floats,  # (q, 3) the points in these
    ) -> None:
        """Paint texels (q,)."""
        values = self._reader.read(place, inside)
        one = 255 if self.image.dtype == np.uint8 else 1
        if self._turn is not None:
            rotated = self._turn.rotate(2 * values[:, :3] / one - 1, place, inside, triangle, weights)
            values[:, :3] = one * (rotated + 1) / 2
        self.image[row, column] = np.rint(values) if one == 255 else values
        self.has_value[row, column] = True


def _turn_between(vectors: Floats, first: Floats, second: Floats) -> Floats:
    """Rotate vectors (q, 3) by the smallest rotations that take unit vectors (q, 3) to others (Rodrigues)."""
    axis = np.cross(first, second)
    cosine = np.einsum("qx,qx->q", first, second)
    once = np.cross(axis, vectors)
    return np.asarray(vectors + once + np.cross(axis, once) / np.maximum(1 + cosine, MIN_VOLUME)[:, None])


def _blocks(atlas: Floats, width: int, height: int) -> Iterator[tuple[Integers, Integers, Integers, Floats]]:
    """Texels that triangles (m, 3, 2) cover or touch: rows from the top, columns, and their places, in blocks."""
    rows = max(1, BAND // width)
    for first in range(0, height, rows):
        count = min(rows, height - first)
        band = np.stack([atlas[:, :, 0], (atlas[:, :, 1] * height - first) / count], axis=2)
        texel, triangle, weights = texels_of(band, width, count)
        for begin in range(0, len(texel), READ_TOGETHER):
            advance((first + count * begin / len(texel)) / height)
            block = slice(begin, begin + READ_TOGETHER)
            row = height - 1 - (first + texel[block] // width)
            yield row, texel[block] % width, triangle[block], weights[block]


def _fill(canvases: Sequence[_Canvas]) -> list[Pixels | None]:
    """Fill texels without a value from the nearest one with a value; None for an image without any value."""
    from scipy.ndimage import distance_transform_edt  # on first use: only baking needs it

    filled = list[Pixels | None]()
    last, nearest = None, None
    for number, canvas in enumerate(canvases):
        advance(number / len(canvases))
        has_value = canvas.has_value
        if not has_value.any():
            filled.append(None)
            continue
        if last is None or not np.array_equal(last, has_value):
            last = has_value
            nearest = tuple(distance_transform_edt(~has_value, return_distances=False, return_indices=True))
        filled.append(canvas.image[nearest])
    return filled
