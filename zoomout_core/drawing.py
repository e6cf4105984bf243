# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw shaded meshes as pictures, with a depth buffer and without any other package, and write pictures as PNG."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from zoomout_core.arrays import Bytes, Floats, Integers, take_rows
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.transfer.groups import expand_ranges
from zoomout_core.transfer.pixels import BLOCK, INSIDE

# Pixels are computed in this many rows and columns each, for smooth borders.
SAMPLES = 2
# The background of upright meshes, and the share of the picture that they fill.
PAPER, FILLED = np.full(3, 0.97), 0.92
# Direction to the light (right, up, towards the viewer), and the brightness of surfaces that face away from it.
LIGHT, SHADOW = np.array([-0.45, 0.55, 0.7]), 0.3


def draw_triangles(
    points: Floats, triangles: Integers, colors: Floats, width: int, height: int, background: Floats
) -> Bytes:
    """Draw triangles, the nearest in front, lit from the upper left; both of their sides are lit.

    Args:
        points: (n, 3) pixels to the right and upwards from the lower left corner, and towards the viewer.
        triangles: (m, 3) vertex numbers.
        colors: (n, 3) red, green and blue of the vertices, 0 to 1.
        width: width of the picture, in pixels.
        height: its height.
        background: (3,) colour.

    Returns:
        (height, width, 3) pixels, rows from top to bottom.
    """
    columns, rows = width * SAMPLES, height * SAMPLES
    shade = np.abs(vertex_normals(points, triangles) @ (LIGHT / np.linalg.norm(LIGHT)))
    lit = colors * (SHADOW + (1 - SHADOW) * shade)[:, None]
    image = np.tile(background, (rows * columns, 1))
    covered, triangle, place = _front(points * [SAMPLES, SAMPLES, 1], triangles, columns, rows)
    image[covered] = np.einsum("cq,qcx->qx", place, lit[triangles[triangle]])
    smooth = image.reshape(height, SAMPLES, width, SAMPLES, 3).mean(axis=(1, 3))[::-1]
    return np.rint(255 * smooth.clip(0, 1)).astype(np.uint8)


def _front(points: Floats, triangles: Integers, columns: int, rows: int) -> tuple[Integers, Integers, Floats]:
    """The nearest of some triangles at each pixel, row by row of each triangle.

    Args:
        points: (n, 3) pixels to the right and upwards from the lower left corner, and towards the viewer.
        triangles: (m, 3) vertex numbers.
        columns: width of the picture.
        rows: its height.

    Returns:
        (q,) the covered pixels, (q,) the nearest triangle at each, and (3, q) barycentric coordinates of its centre.
    """
    corner = np.ascontiguousarray(triangles.T)
    x, y, z = (take_rows(np.ascontiguousarray(each), corner) for each in points.T)
    left, right = _centres(x.min(axis=0), x.max(axis=0), columns)
    bottom, top = _centres(y.min(axis=0), y.max(axis=0), rows)
    doubled = x[0] * (y[1] - y[2]) + x[1] * (y[2] - y[0]) + x[2] * (y[0] - y[1])  # zero if seen from the edge
    seen = np.flatnonzero((right > left) & (top > bottom) & (doubled != 0))
    x, y, z = x[:, seen], y[:, seen], z[:, seen]
    # Barycentric coordinates (3, t) are linear: their slopes, and their values in the lower left corner of the picture.
    along_x = (y[[1, 2, 0]] - y[[2, 0, 1]]) / doubled[seen]
    along_y = (x[[2, 0, 1]] - x[[1, 2, 0]]) / doubled[seen]
    origin = 1 / 3 - along_x * x.mean(axis=0) - along_y * y.mean(axis=0)

    owner, row = expand_ranges(bottom[seen], top[seen])
    at_left = origin[:, owner] + along_y[:, owner] * (row + 0.5)
    first, end = _centres(*_positive_interval(at_left, along_x[:, owner]), columns)
    depth_at_left, depth_along_x = (at_left * z[:, owner]).sum(axis=0), (along_x * z).sum(axis=0)[owner]
    lowest, highest = z.min(axis=0)[owner], z.max(axis=0)[owner]
    nearest, depth = np.full(rows * columns, -1), np.full(rows * columns, -np.inf)
    for block in np.split(np.arange(len(owner)), np.flatnonzero(np.diff(np.cumsum(end - first) // BLOCK)) + 1):
        line, column = expand_ranges(first[block], end[block])
        line = block[line]
        pixel, towards = row[line] * columns + column, depth_at_left[line] + depth_along_x[line] * (column + 0.5)
        towards = towards.clip(lowest[line], highest[line])  # narrow triangles are steep: rounding errors become large
        np.maximum.at(depth, pixel, towards)
        is_front = towards == depth[pixel]
        nearest[pixel[is_front]] = owner[line[is_front]]
    covered = np.flatnonzero(nearest >= 0)
    front = nearest[covered]
    place = origin[:, front] + along_x[:, front] * (covered % columns + 0.5)
    place += along_y[:, front] * (covered // columns + 0.5)
    return covered, seen[front], place.clip(0, 1)


def _positive_interval(values: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """(r,) and (r,) the ends of the intervals where three linear functions, of these (3, r) values at 0, are positive.

    An interval without such places ends before it begins.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        zero = -values / slopes
    is_never = (slopes == 0) & (values < 0)
    low = np.where(slopes > 0, zero, np.where(is_never, np.inf, -np.inf))
    return low.max(axis=0), np.where(slopes < 0, zero, np.inf).min(axis=0)


def _centres(low: Floats, high: Floats, count: int) -> tuple[Integers, Integers]:
    """The first pixel (m,), in a row of pixels, with its centre in an interval, and (m,) the one after the last."""
    first = np.ceil(low - 0.5 - INSIDE).clip(0, count)
    end = np.floor(high + 0.5 + INSIDE).clip(0, count)
    return first.astype(np.int64), np.maximum(first, end).astype(np.int64)


def draw_upright(points: Floats, triangles: Integers, colors: Floats, yaw: float, width: int, height: int) -> Bytes:
    """Draw a mesh whose y axis is up, filling the picture.

    Args:
        points: (n, 3) vertices.
        triangles: (m, 3) vertex numbers.
        colors: (n, 3) red, green and blue of the vertices, 0 to 1.
        yaw: degrees about the vertical axis from the z axis to the viewer.
        width: width of the picture, in pixels.
        height: its height.

    Returns:
        (height, width, 3) pixels, rows from top to bottom.
    """
    angle = np.radians(yaw)
    right, towards = np.array([[np.cos(angle), 0, -np.sin(angle)], [np.sin(angle), 0, np.cos(angle)]])
    seen = points @ np.array([right, [0, 1, 0], towards]).T
    low, high = seen.min(axis=0), seen.max(axis=0)
    scale = FILLED * float((np.array([width, height]) / np.maximum(high - low, np.finfo(float).tiny)[:2]).min())
    placed = (seen - (low + high) / 2) * scale + [width / 2, height / 2, 0]
    return draw_triangles(placed, triangles, colors, width, height, PAPER)


def encode_png(image: Bytes) -> bytes:
    """The content of a PNG file of an image (height, width, 3), rows from top to bottom."""
    height, width = image.shape[:2]
    rows = np.column_stack([np.zeros((height, 1), np.uint8), image.reshape(height, -1)]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )
