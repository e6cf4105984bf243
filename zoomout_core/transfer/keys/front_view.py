# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of a face, seen from the front."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.keys.head_directions import HeadDirections
from zoomout_core.transfer.pixels import INSIDE, pixels_near

# Minimum height of an image relative to its width. If the keys of both eyes close the same eye, both centres coincide,
# and the image would be as narrow as the distance between them.
MAX_HEIGHT = 20


@dataclass(frozen=True, eq=False)
class FrontView:
    """A depth image of a surface: square pixels around a point (3,), aligned with the directions of a head."""

    origin: Floats  # (3,) the centre along the directions left, up and forward
    pixel: float  # length of a side of a pixel
    depth: Floats  # (columns, rows) position of the visible surface along the direction forward; -inf where none
    corners: Integers  # (columns, rows, 3) the vertices of the visible triangle
    weights: Floats  # (columns, rows, 3) barycentric coordinates in it; zero where no triangle is visible

    @property
    def across(self) -> Floats:
        """Positions (columns,) of the columns along the direction left."""
        columns = self.depth.shape[0]
        return np.asarray((np.arange(columns) + (1 - columns) / 2) * self.pixel + self.origin[0])

    def height_of(self, row: Floats) -> Floats:
        """Positions (q,) along the direction up of the lower borders of rows (q,)."""
        return np.asarray((row - self.depth.shape[1] / 2) * self.pixel + self.origin[1])

    def interpolate(self, values: Floats) -> Floats:
        """Values (columns, rows) of the visible surface, from those of its vertices (n,)."""
        return np.asarray(np.einsum("xyc,xyc->xy", self.weights, values[self.corners]))

    def nearest_corners(self, chosen: Booleans) -> Integers:
        """The vertices nearest to chosen pixels (columns, rows), of the triangles visible there."""
        seen = chosen & np.isfinite(self.depth)
        corners, weights = self.corners[seen], self.weights[seen]
        return np.unique(corners[np.arange(len(corners)), weights.argmax(axis=1)])

    def close(self, height: float) -> Floats:
        """The depth (columns, rows) after a morphological closing of each column, by a height.

        The closing fills in narrower valleys. The difference, called black top-hat, is their depth (Serra, Image
        Analysis and Mathematical Morphology, 1982).
        """
        seen = np.isfinite(self.depth)
        depth = np.where(seen, self.depth, self.depth[seen].min() - height)
        return np.asarray(scipy.ndimage.grey_closing(depth, (1, round(height / self.pixel)), mode="nearest"))


def view_from_front(
    vertices: Floats,
    triangles: Integers,
    centre: Floats,
    head: HeadDirections,
    half: tuple[float, float],
    columns: int,
) -> FrontView | None:
    """Draw a surface of vertices (n, 3) and triangles (m, 3) around a centre (3,).

    Takes half the width and half the height of the image, and the number of its columns. None if the image is empty, a
    single row, or much higher than wide.
    """
    if not 0 <= half[1] < MAX_HEIGHT * half[0]:
        return None
    axes, pixel = np.stack([head.left, head.up, head.forward]), 2 * half[0] / columns
    rows = round(2 * half[1] / pixel)
    if rows < 2:
        return None
    size = np.array([columns, rows]) * pixel / 2
    places = ((vertices - centre) @ axes.T)[triangles]
    inside = ((places[:, :, :2].max(axis=1) > -size) & (places[:, :, :2].min(axis=1) < size)).all(axis=1)
    places, triangles = places[inside], triangles[inside]
    depth, weights = np.full(columns * rows, -np.inf), np.zeros((columns * rows, 3))
    corners = np.zeros((columns * rows, 3), dtype=np.int64)
    for column, row, triangle, place, distance in pixels_near(
        places[:, :, :2] / (2 * size) + 0.5, columns, rows, window=True
    ):
        on = np.flatnonzero(distance <= INSIDE)
        pixels, triangle, place = (column * rows + row)[on], triangle[on], place[on]
        forward = np.einsum("qc,qc->q", place, places[triangle, :, 2])
        np.maximum.at(depth, pixels, forward)
        front = forward == depth[pixels]
        corners[pixels[front]], weights[pixels[front]] = triangles[triangle[front]], place[front]
    if not weights.any():
        return None
    origin, shape = axes @ centre, (columns, rows)
    depth = (depth + origin[2]).reshape(shape)
    return FrontView(origin, pixel, depth, corners.reshape(*shape, 3), weights.reshape(*shape, 3))


def enclosed_pieces(chosen: Booleans) -> Integers:
    """Label connected pieces of chosen pixels (columns, rows) from 1; 0 elsewhere, and for pieces at the border."""
    piece, _ = scipy.ndimage.label(chosen)
    border = np.concatenate([piece[[0, -1]].ravel(), piece[:, [0, -1]].ravel()])
    return np.where(np.isin(piece, border), 0, piece)
