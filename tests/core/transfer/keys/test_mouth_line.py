# SPDX-License-Identifier: GPL-3.0-or-later
"""The line between the lips, seen from the front."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from zoomout_core.samples.grids import grid, grid_faces, triangles_of
from zoomout_core.transfer.keys.head_directions import HeadDirections
from zoomout_core.transfer.keys.mouth_line import (
    MouthLine,
    find_best_path,
    find_lips,
    find_mouth_line,
    match_lips,
    sides_of_mouth,
)

HEAD = HeadDirections(*np.eye(3), 1.0)
WIDTH = 0.3
PLANE = grid(np.linspace(-0.6, 0.6, 61), np.linspace(-0.35, 0.35, 141)).vertices
TRIANGLES = triangles_of(grid_faces(60, 140))
PIXEL = 0.00625


def bow(x: np.ndarray, width: float = WIDTH) -> np.ndarray:
    """Heights of the line between the lips."""
    return 0.04 * np.cos(np.pi * x / width)


@cache
def skin(width: float = WIDTH, height: float = 0.0, crease: float = 0.015) -> np.ndarray:
    """(n, 3) a skin with a crease between lips, which may be apart, and a rounded valley that is longer than it."""
    places = PLANE.copy()
    x, y = places[:, 0], places[:, 1]
    from_line = y - bow(x, width)
    share = np.clip(1 - (x / width) ** 2, 0, 1)
    valley = 0.03 * np.exp(-((from_line / 0.06) ** 2)) * np.clip(4 - 2.5 * np.abs(x / width), 0, 1)
    sharp = crease * np.clip(1 - np.abs(from_line) / 0.02, 0, 1) * (np.abs(x) < width)
    places[:, 2] = -np.where(np.abs(from_line) < height * share, 0.3, valley + sharp)
    return places


@cache
def line(width: float = WIDTH, height: float = 0.0) -> MouthLine:
    found = find_mouth_line(skin(width, height), TRIANGLES, np.zeros(3), HEAD)
    assert found is not None
    return found


def test_the_line_follows_the_crease_up_to_the_corners() -> None:
    found = line()
    np.testing.assert_allclose(found.corners, (-WIDTH, WIDTH), atol=0.04)
    inner = np.abs(found.across) < 0.9 * WIDTH
    np.testing.assert_allclose(found.upper[inner], bow(found.across[inner]), atol=2 * PIXEL)
    np.testing.assert_array_equal(found.upper[inner], found.lower[inner])


def test_parted_lips_have_two_rims() -> None:
    found = line(height=0.06)
    middle = np.abs(found.across) < 0.05
    np.testing.assert_allclose(found.upper[middle], 0.1, atol=3 * PIXEL)
    np.testing.assert_allclose(found.lower[middle], -0.02, atol=3 * PIXEL)
    np.testing.assert_allclose(found.corners, (-WIDTH, WIDTH), atol=0.04)


def test_line_does_not_depend_on_the_placement() -> None:
    moved = find_mouth_line(skin() + np.array([3.0, 4.0, 5.0]), TRIANGLES, np.array([3.04, 3.97, 5.1]), HEAD)
    assert moved is not None
    np.testing.assert_allclose(np.subtract(moved.corners, 3), (-WIDTH, WIDTH), atol=0.04)
    middle = np.abs(moved.across - 3) < 0.05
    np.testing.assert_allclose(moved.upper[middle], 4.04, atol=2 * PIXEL)


def test_flat_skin_has_no_line() -> None:
    level = skin() * (1, 1, 0)
    assert find_mouth_line(level, TRIANGLES, np.zeros(3), HEAD) is None
    assert find_mouth_line(level, TRIANGLES, np.array([9.0, 0, 0]), HEAD) is None


@pytest.mark.parametrize(("height", "is_clear"), [(0.12, False), (0.22, True)])
def test_lips_with_holes_have_no_clear_line_but_nostrils_may_be_above(height: float, is_clear: bool) -> None:
    vertices = skin()
    hole = (np.abs(vertices[:, 0]) < 0.1) & (np.abs(vertices[:, 1] - height) < 0.02)
    whole = TRIANGLES[~hole[TRIANGLES].any(axis=1)]
    assert (find_mouth_line(vertices, whole, np.zeros(3), HEAD) is not None) == is_clear


def test_a_deep_valley_above_the_chin_is_no_hole_in_a_lip() -> None:
    vertices = skin(height=0.06).copy()
    vertices[(np.abs(vertices[:, 0]) < 0.12) & (vertices[:, 1] < -0.07), 2] = -0.3
    found = find_mouth_line(vertices, TRIANGLES, np.array([0, 0.1, 0]), HEAD)
    assert found is not None
    np.testing.assert_allclose(found.corners, (-WIDTH, WIDTH), atol=0.04)


def test_lips_shift_to_those_of_a_wider_mouth() -> None:
    vertices = skin()
    is_upper = vertices[:, 1] > bow(vertices[:, 0])
    chosen, shifts = match_lips(vertices, is_upper, line(), line(1.3 * WIDTH, 0.06), HEAD)
    places = vertices[chosen]
    inner = np.abs(places[:, 0]) < 0.9 * WIDTH
    assert inner.sum() > 50
    rise = np.where(is_upper[chosen], 0.06, -0.06) * (1 - (places[:, 0] / WIDTH) ** 2)
    expected = np.column_stack([0.3 * places[:, 0], rise, 0 * rise])
    np.testing.assert_allclose(shifts[inner], expected[inner], atol=0.03)


def test_line_bridges_a_short_gap_where_lips_are_level() -> None:
    vertices = skin().copy()
    vertices[np.abs(vertices[:, 0] - 0.11) < 0.015, 2] = 0
    found = find_mouth_line(vertices, TRIANGLES, np.zeros(3), HEAD)
    assert found is not None
    np.testing.assert_allclose(found.corners, (-WIDTH, WIDTH), atol=0.04)


def test_bands_beside_the_line_are_on_one_lip_each() -> None:
    vertices, found = skin(), line()
    for band, side in ((found.above, 1), (found.below, -1)):
        beyond = side * (vertices[band, 1] - bow(vertices[band, 0]))
        assert len(band) > 50
        assert beyond.min() > 0
        assert beyond.max() < 0.1


def test_a_lip_hidden_behind_the_other_keeps_its_side() -> None:
    flat = PLANE * (1, 1, 0)
    upper, lower = flat[flat[:, 1] > -0.07] - (0, 0, 0.02), flat[flat[:, 1] < 0.01]
    vertices, count = np.vstack([upper, lower]), len(upper)
    places = np.concatenate([np.flatnonzero(flat[:, 1] > -0.07), np.flatnonzero(flat[:, 1] < 0.01)])
    number = np.full((2, len(flat)), -1)
    number[0, places[:count]], number[1, places[count:]] = np.arange(count), count + np.arange(len(lower))
    triangles = np.concatenate([each[TRIANGLES] for each in number])
    triangles = triangles[(triangles >= 0).all(axis=1)]
    is_upper, y = np.arange(len(vertices)) < count, vertices[:, 1]
    above, below = (np.flatnonzero(each) for each in (is_upper & (y > 0.01) & (y < 0.05), ~is_upper & (y > -0.05)))
    sides = sides_of_mouth(vertices, triangles, replace(line(), above=above, below=below), HEAD)
    np.testing.assert_array_equal(sides[is_upper & (y < 0.1)], 1)
    np.testing.assert_array_equal(sides[~is_upper & (y > -0.1)], -1)


def test_places_far_from_the_mouth_have_no_side() -> None:
    sides = sides_of_mouth(skin(), TRIANGLES, line(), HEAD)
    x, y = PLANE[:, 0], PLANE[:, 1] - bow(PLANE[:, 0])
    assert np.abs(sides[np.abs(x) > 0.58]).max() < 0.1
    assert (np.sign(y) * sides)[(np.abs(y) > 0.04) & (np.abs(y) < 0.1) & (np.abs(x) < 0.1)].min() > 0.4


def test_lips_without_visible_bands_have_no_sides() -> None:
    sides = sides_of_mouth(skin(), TRIANGLES, replace(line(), above=np.empty(0, dtype=np.int64)), HEAD)
    assert not sides.any()


@pytest.mark.parametrize(("opens", "found"), [(True, True), (False, False)])
def test_lips_are_found_where_the_motion_of_the_jaw_jumps(opens: bool, found: bool) -> None:
    vertices = skin()
    below = vertices[:, 1] < bow(vertices[:, 0])
    motion = np.where(below, 1.0, 0.1) if opens else np.clip(0.5 - vertices[:, 1], 0, 1)
    middle = find_lips(vertices, TRIANGLES, motion, (np.array([0, 0.5, 0]), np.array([0, -0.4, 0])), HEAD)
    assert (middle is not None) == found
    if middle is not None:
        np.testing.assert_allclose(middle, (0, bow(np.zeros(1))[0], 0), atol=0.03)


@pytest.mark.parametrize(("size", "jaw"), [(1e-17, -0.3), (1.0, 0.29), (1.0, 0.5)])
def test_coincident_eyes_or_a_jaw_between_them_have_no_lips(size: float, jaw: float) -> None:
    vertices = skin()
    motion = np.where(vertices[:, 1] < bow(vertices[:, 0]), 1.0, 0.1)
    places = np.array([0, 0.3, 0]), np.array([0, jaw, 0])
    assert find_lips(vertices, TRIANGLES, motion, places, replace(HEAD, size=size)) is None


def test_best_path_has_the_largest_sum() -> None:
    values = np.random.default_rng(0).random((5, 4))
    column = np.arange(5)
    paths = [np.array(rows) for rows in product(range(4), repeat=5) if (np.abs(np.diff(rows)) < 2).all()]
    best = max(paths, key=lambda rows: float(values[column, rows].sum()))
    np.testing.assert_array_equal(find_best_path(values), best)
