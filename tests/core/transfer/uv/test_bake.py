# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked textures show the right place at each texel, and nothing from outside an island."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import pixels
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.uv import bake as module
from zoomout_core.transfer.uv.bake import Baked, CornerNormals, Picture, bake

BACKGROUND = 255  # blue value of the background; islands have zero


def square(cells: int) -> Surface:
    """The triangulated unit square."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1)))
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = first, first + 1, first + cells + 2, first + cells + 1
    return Surface(np.column_stack([x, y, 0 * x]), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


SOURCE, TARGET = square(8), square(7)


def corners(surface: Surface) -> np.ndarray:
    """(c, 2) positions of the corners in the square."""
    return surface.vertices[surface.corner_vertex, :2]


def two_islands(place: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(q, 2) UVs of places in an atlas that separates the left and right half of the square by a gutter."""
    return np.column_stack([0.03 + 0.7 * place[:, 0] + 0.24 * right, 0.1 + 0.8 * place[:, 1]])


RIGHT = np.repeat(corners(SOURCE).reshape(-1, 3, 2)[:, :, 0].mean(axis=1) > 0.5, 3)
ATLAS = two_islands(corners(SOURCE), RIGHT)
NUMBER = np.zeros(len(SOURCE.triangles), dtype=int)


def picture(size: int) -> Picture:
    """A picture of the atlas: red is x, green is y, and blue marks the background."""
    u, v = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5)[::-1] / size)
    right = u > 0.5
    x, y = (u - 0.03 - 0.24 * right) / 0.7, (v - 0.1) / 0.8
    inside = (x > 0) & (x < 1) & (y > 0) & (y < 1) & ((x > 0.5) == right)
    image = np.stack([20 + 200 * x, 20 + 200 * y, 0 * x], axis=-1)
    image[~inside] = [0, 0, BACKGROUND]
    return Picture([np.rint(image).astype(np.uint8)], NUMBER, ATLAS)


def mapped_square() -> MappedTarget:
    found = closest_points(TARGET.vertices, SOURCE.vertices, SOURCE.triangles)
    return MappedTarget(SOURCE, TARGET, SurfaceMap(*found, SOURCE.triangles), np.ones(len(TARGET.vertices)))


def bake_square(atlas: np.ndarray, shown: Picture, uv: np.ndarray, width: int = 64, height: int = 64) -> Baked:
    return bake(mapped_square(), [replace(shown, uv=atlas)], uv, width, height)


def places(image: np.ndarray) -> np.ndarray:
    """(h, w, 2) places that the colours encode."""
    return (image[:, :, :2].astype(float) - 20) / 200


@pytest.mark.parametrize("size", [16, 33, 128])
def test_texels_show_their_places_and_never_the_background(size: int) -> None:
    uv = 0.1 + 0.8 * corners(TARGET)[:, ::-1]  # transposed
    made = bake_square(ATLAS, picture(size), uv, 64, 96)
    assert made.images[0].shape == (96, 64, 3)
    assert not made.images[0][:, :, 2].any()
    u, v = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(96) + 0.5)[::-1] / 96)
    inside = (np.abs(u - 0.5) < 0.4) & (np.abs(v - 0.5) < 0.4)
    assert made.covered[inside].all()
    true = np.stack([v - 0.1, u - 0.1], axis=-1) / 0.8
    # Beside the source's borders and seams the nearest texel of the island is used, up to one texel off.
    assert np.abs(places(made.images[0]) - true)[inside].max() < 1 / (0.7 * size) + 0.006
    assert np.abs(places(made.images[0]) - true)[inside].mean() < 0.1 / size + 0.003
    assert not made.outside.any()


def test_gutters_take_the_texel_of_the_nearest_island() -> None:
    right = np.repeat(corners(TARGET).reshape(-1, 3, 2)[:, :, 0].mean(axis=1) > 0.5, 3)
    uv = 0.3 * corners(TARGET) + np.where(right[:, None], [0.6, 0.1], [0.05, 0.5])
    made = bake_square(ATLAS, picture(128), uv, 100, 100)
    assert not made.images[0][:, :, 2].any()
    assert 0.05 < made.covered.mean() < 0.2
    x = places(made.images[0])[:, :, 0]
    assert x[0, 0] < 0.05  # nearest to the left island's left border
    assert x[-1, -1] > 0.95
    assert np.ptp(x[:40, -30:]) < 0.5


@pytest.mark.parametrize("tile", [0, 3])
def test_tip_without_a_texel_reads_the_nearest_of_its_island(tile: int) -> None:
    """The island is a wedge that is thinner than a texel at its left end."""
    place = corners(SOURCE)
    atlas = np.column_stack([0.1 + 0.8 * place[:, 0], 0.53 + 0.4 * (place[:, 1] - 0.5) * place[:, 0]])
    u, v = np.meshgrid((np.arange(16) + 0.5) / 16, (np.arange(16) + 0.5)[::-1] / 16)
    x = (u - 0.1) / 0.8
    inside = (x > 0) & (x < 1) & (np.abs(v - 0.53) < 0.2 * x)
    image = np.where(inside[..., None], [9, 9, 0], [0, 0, BACKGROUND]).astype(np.uint8)
    made = bake_square(atlas + tile, Picture([image], NUMBER, ATLAS), corners(TARGET))
    assert (made.images[0] == [9, 9, 0]).all()


@pytest.mark.parametrize("alone", [True, False])
def test_island_without_a_texel_is_read_at_its_place(alone: bool) -> None:
    small = np.array([0.8, 0.8]) + 0.01 * corners(SOURCE)
    atlas = small if alone else np.where(RIGHT[:, None], small, 0.6 * corners(SOURCE))
    image = np.zeros((4, 4, 3), dtype=np.uint8)
    image[0, 3] = [7, 8, 9]  # the upper right texel
    made = bake_square(atlas, Picture([image], NUMBER, ATLAS), corners(TARGET), 8, 8)
    assert (made.images[0][:, 5:] == [7, 8, 9]).all()


def test_block_size_does_not_change_results(monkeypatch: pytest.MonkeyPatch) -> None:
    uv = 0.1 + 0.8 * corners(TARGET)[:, ::-1]
    at_once = bake_square(ATLAS, picture(33), uv)
    monkeypatch.setattr(pixels, "BLOCK", 64)
    monkeypatch.setattr(module, "READ_TOGETHER", 100)
    monkeypatch.setattr(module, "BAND", 640)
    np.testing.assert_array_equal(bake_square(ATLAS, picture(33), uv).images[0], at_once.images[0])


def test_images_repeat_beyond_the_unit_square() -> None:
    image = np.random.default_rng(0).integers(0, 255, (8, 8, 4), dtype=np.uint8)
    number = NUMBER
    for repeats in (1, 16):  # within one copy of the image, or across several
        at_home, away = (
            bake_square(repeats * corners(SOURCE) + shift, Picture([image], number, ATLAS), corners(TARGET))
            for shift in (0, 5)
        )
        np.testing.assert_allclose(at_home.images[0].astype(int), away.images[0], atol=1)
    assert len(np.unique(at_home.images[0].reshape(-1, 4), axis=0)) > 20


def test_every_triangle_is_read_in_its_own_image() -> None:
    images = [np.full((4, 4, 3), level, dtype=np.uint8) for level in (10, 200)]
    number = RIGHT.reshape(-1, 3)[:, 0].astype(int)
    made = bake_square(corners(SOURCE), Picture(images, number, ATLAS), corners(TARGET))
    assert set(made.images[0][:, :31].ravel()) == {10}
    assert set(made.images[0][:, 33:].ravel()) == {200}


def test_faces_outside_the_image_are_reported() -> None:
    uv = corners(TARGET) + np.array([0.5, 0])
    made = bake_square(ATLAS, picture(64), uv)
    off = (uv.reshape(-1, 3, 2)[:, :, 0] > 1).any(axis=1)
    np.testing.assert_array_equal(made.outside, off)
    with pytest.raises(MeshError, match="cover no texel of the image"):
        bake_square(ATLAS, picture(64), uv + 5)
    with pytest.raises(ValueError, match="width is 0"):
        bake_square(ATLAS, picture(64), uv, 0)


def test_several_pictures_are_baked_at_once_in_their_own_precision() -> None:
    fine = np.random.default_rng(1).normal(size=(8, 8, 1)).astype(np.float32)
    shown = Picture([fine], NUMBER, corners(SOURCE))
    on_the_right = Picture([np.full((4, 4, 3), 9, np.uint8)], RIGHT.reshape(-1, 3)[:, 0].astype(int) - 1, ATLAS)
    absent = replace(shown, number=NUMBER - 1)
    made = bake(mapped_square(), [shown, on_the_right, absent], corners(TARGET), 8, 8)
    np.testing.assert_allclose(made.images[0], fine, atol=1e-5)
    assert made.images[0].dtype == np.float32
    assert (made.images[1] == 9).all()
    assert made.images[2] is None


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("relief", [False, True])
def test_normals_keep_their_direction_on_the_surface(mirrored: bool, relief: bool) -> None:
    """The target is rotated in space, and its atlas is rotated, and perhaps mirrored, beside the source's."""
    turn = Rotation.from_rotvec([0.4, -0.9, 0.3])
    tilted = np.array([0.36, -0.48, 0.8])
    image = np.tile(np.rint(255 * (tilted + 1) / 2).astype(np.uint8), (4, 4, 1))
    shown = Picture([image], NUMBER, corners(SOURCE), normals=True)
    uv = corners(TARGET)[:, ::-1] if mirrored else np.column_stack([1 - corners(TARGET)[:, 1], corners(TARGET)[:, 0]])
    placed = replace(mapped_square(), target=TARGET.with_vertices(turn.apply(TARGET.vertices)))
    upright = np.tile([0.0, 0, 1], (len(RIGHT), 1)), turn.apply(np.tile([0.0, 0, 1], (len(TARGET.corner_vertex), 1)))
    made = bake(placed, [shown], uv, 16, 16, CornerNormals(*upright, relief=relief)).images[0]
    x, y, z = tilted
    expected = [y, x, z] if mirrored else [-y, x, z]  # u is y on the target, or falls with it; v is x
    np.testing.assert_allclose(made.astype(float) / 127.5 - 1, np.tile(expected, (16, 16, 1)), atol=0.012)


def test_relief_that_the_target_lacks_is_baked_on_request() -> None:
    waves = 0.3 * np.sin(6 * SOURCE.vertices[:, 0])
    tilted = np.column_stack([-waves, 0 * waves, np.sqrt(1 - waves**2)])[SOURCE.corner_vertex]
    flat = np.tile(np.rint(255 * np.array([0.5, 0.5, 1])).astype(np.uint8), (4, 4, 1))
    shown = Picture([flat], NUMBER, corners(SOURCE), normals=True)
    upright = np.tile([0.0, 0, 1], (len(TARGET.corner_vertex), 1))
    without, with_relief = (
        bake(mapped_square(), [shown], corners(TARGET), 32, 32, CornerNormals(tilted, upright, relief)).images[0]
        for relief in (False, True)
    )
    assert np.abs(without.astype(float) - flat[0, 0]).max() <= 1
    x = (np.arange(32) + 0.5) / 32
    np.testing.assert_allclose(with_relief[16, :, 0] / 127.5 - 1, -0.3 * np.sin(6 * x), atol=0.04)
    with pytest.raises(ValueError, match="normals is None"):
        bake(mapped_square(), [shown], corners(TARGET), 8, 8)
