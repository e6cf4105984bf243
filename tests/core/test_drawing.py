# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes are drawn with the nearest surfaces in front, and pictures are written as PNG."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from zoomout_core import drawing
from zoomout_core.drawing import draw_triangles, encode_png
from zoomout_core.samples.grids import grid_faces, triangles_of
from zoomout_core.samples.spheres import ball

WHITE, RED, BLUE = np.ones(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0])


def test_nearest_triangle_is_in_front_in_any_draw_order() -> None:
    corners = np.array([[1.0, 1], [19, 1], [1, 9]])
    points = np.vstack([np.column_stack([corners, np.full(3, depth)]) for depth in (5.0, 1.0)])
    colors = np.repeat([RED, BLUE], 3, axis=0)
    for order in ([0, 1], [1, 0]):
        picture = draw_triangles(points, np.arange(6).reshape(2, 3)[order], colors, 20, 10, WHITE)
        assert picture.shape == (10, 20, 3)
        red, _, blue = picture[7, 3]  # rows begin at the top, points at the bottom
        assert red > 100
        assert blue == 0
        np.testing.assert_array_equal(picture[1, 18], [255, 255, 255])


def test_narrow_triangles_stay_behind_what_is_in_front_of_them() -> None:
    wall = np.array([[-40.0, -40, 1], [80, -40, 1], [-40, 80, 1]])
    beside = 0.25 + 4e-7  # centres of pixels are at .25, see `SAMPLES`
    narrow = np.array([[beside, 0, 0], [beside, 20, 0], [beside + 1e-8, 10, -1e6]])
    points, triangles = np.vstack([wall, narrow]), np.arange(6).reshape(2, 3)
    picture = draw_triangles(points, triangles, np.repeat([RED, BLUE], 3, axis=0), 20, 20, WHITE)
    np.testing.assert_array_equal(picture[:, :, 2], 0)


@pytest.mark.parametrize("block", [drawing.BLOCK, 50])
def test_neighbours_leave_no_gap(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "BLOCK", block)  # pixels are computed in blocks
    u, v = np.meshgrid(np.linspace(-40, 40, 41), np.linspace(-40, 40, 41))  # corners are at centres of pixels
    points = np.stack([u - v / 4, v + u / 4, 0 * u], axis=-1).reshape(-1, 3)
    triangles = triangles_of(grid_faces(40, 40))
    np.testing.assert_array_equal(draw_triangles(points, triangles, np.zeros_like(points), 20, 20, WHITE), 0)


def test_a_ball_is_lit_from_the_upper_left_and_is_round() -> None:
    made = ball(8.0, (10.0, 10.0, 0.0), count=3000)
    skin, black = np.ones_like(made.vertices), np.zeros(3)
    picture = draw_triangles(made.vertices, made.triangles, skin, 20, 20, black)
    covered = (picture > 0).all(axis=2)
    assert abs(covered.sum() - np.pi * 64) < 20
    assert picture[5, 6, 0] > picture[14, 14, 0] + 50
    # Triangles that reach beyond the picture are cut off.
    beyond = draw_triangles(
        made.vertices - [10, 0, 0], made.triangles, np.ones_like(made.vertices), 20, 20, np.zeros(3)
    )
    np.testing.assert_array_equal(beyond[:, 8:], 0)
    assert beyond[10, 0, 0] > 0


def test_encoded_png_contains_the_pixels() -> None:
    image = np.random.default_rng(0).integers(0, 256, (3, 5, 3)).astype(np.uint8)
    content = encode_png(image)
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    assert struct.unpack(">II", content[16:24]) == (5, 3)
    start = content.index(b"IDAT") + 4
    rows = np.frombuffer(zlib.decompress(content[start:]), np.uint8).reshape(3, 16)
    np.testing.assert_array_equal(rows[:, 1:].reshape(3, 5, 3), image)
