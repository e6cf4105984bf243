# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw shaded meshes as pictures, with a depth buffer and without any other package, and write pictures as PNG."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from zoomout_core.arrays import Bytes, Floats, Integers
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.transfer.groups import first_of_each
from zoomout_core.transfer.pixels import INSIDE, pixels_near

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
    depth, image = np.full(rows * columns, -np.inf), np.tile(background, (rows * columns, 1))
    corners = points[triangles]
    for x, y, triangle, place, distance in pixels_near(corners[:, :, :2] / [width, height], columns, rows, window=True):
        inside = np.flatnonzero(distance <= INSIDE)
        pixel, triangle, place = (y * columns + x)[inside], triangle[inside], place[inside]
        towards = np.einsum("qc,qc->q", place, corners[triangle, :, 2])
        front = first_of_each(pixel, -towards)
        front = front[towards[front] > depth[pixel[front]]]
        depth[pixel[front]] = towards[front]
        image[pixel[front]] = np.einsum("qc,qcx->qx", place[front], lit[triangles[triangle[front]]])
    smooth = image.reshape(height, SAMPLES, width, SAMPLES, 3).mean(axis=(1, 3))[::-1]
    return np.rint(255 * smooth.clip(0, 1)).astype(np.uint8)


def draw_upright(points: Floats, triangles: Integers, colors: Floats, yaw: float, width: int, height: int) -> Bytes:
    """Draw a mesh whose y axis is up, as large as the picture permits.

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
