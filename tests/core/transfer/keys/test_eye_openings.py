# SPDX-License-Identifier: GPL-3.0-or-later
"""The openings between eyelids, seen from the front."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.samples.grids import grid, grid_faces, triangles_of
from zoomout_core.transfer.keys.eye_openings import EyeOpening, find_eye_opening, match_rims
from zoomout_core.transfer.keys.head_directions import HeadDirections

AXES = np.eye(3)
HEAD = HeadDirections(AXES[0], AXES[1], AXES[2], 1.0)
WIDTH, HEIGHT = 0.2, 0.08  # half the axes of an elliptic opening
SIDE = np.linspace(-0.5, 0.5, 81)
PIXEL = 0.01
TRIANGLES = triangles_of(grid_faces(80, 80))
STILL = np.zeros((len(SIDE) ** 2, 3))


def skin(width: float = WIDTH, height: float = HEIGHT, depth: float = 0.4) -> np.ndarray:
    """(n, 3) a skin with an elliptic socket, and a shallow valley beside it as at a nose."""
    places = grid(SIDE, SIDE).vertices.copy()
    x, y = places[:, 0], places[:, 1]
    valley = 0.08 * np.exp(-((x + 0.28) ** 2 / 0.002 + y**2 / 0.002))
    places[:, 2] = -np.where((x / width) ** 2 + (y / height) ** 2 < 1, depth, valley)
    return places


def opening(vertices: np.ndarray, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> EyeOpening:
    found = find_eye_opening(vertices, TRIANGLES, np.array(centre), HEAD)
    assert found is not None
    return found


def test_rims_are_at_the_edge_of_the_socket() -> None:
    found = opening(skin())
    np.testing.assert_allclose(found.across[[0, -1]], (-WIDTH, WIDTH), atol=3 * PIXEL)
    np.testing.assert_allclose(found.upper.max(), HEIGHT, atol=2 * PIXEL)
    np.testing.assert_allclose(found.lower.min(), -HEIGHT, atol=2 * PIXEL)


def test_opening_does_not_depend_on_the_placement() -> None:
    moved = opening(skin() + np.array([3.0, 4.0, 5.0]), (3.04, 3.97, 5.1))
    np.testing.assert_allclose(moved.upper.max(), 4 + HEIGHT, atol=2 * PIXEL)
    np.testing.assert_allclose(moved.area, opening(skin()).area, rtol=0.1)


def test_slit_beyond_the_corner_is_not_part_of_the_opening() -> None:
    vertices = skin()
    slit = (np.abs(vertices[:, 1]) < 0.01) & (np.abs(vertices[:, 0]) < 1.5 * WIDTH)
    vertices[slit, 2] = -0.4
    np.testing.assert_allclose(opening(vertices).across[[0, -1]], (-WIDTH, WIDTH), atol=3 * PIXEL)


def test_a_hole_without_a_socket_is_an_opening() -> None:
    behind = (skin()[TRIANGLES][:, :, 2] < -0.2).any(axis=1)
    found = find_eye_opening(skin(), TRIANGLES[~behind], np.zeros(3), HEAD)
    assert found is not None
    np.testing.assert_allclose(found.upper.max(), HEIGHT, atol=3 * PIXEL)


@pytest.mark.parametrize("depth", [0.0, 0.05])
def test_a_closed_eye_has_no_opening(depth: float) -> None:
    assert find_eye_opening(skin(depth=depth), TRIANGLES, np.zeros(3), HEAD) is None


@pytest.mark.parametrize("height", [0.14, 0.2])
def test_opening_too_high_to_close_is_not_found(height: float) -> None:
    assert find_eye_opening(skin(0.25, height), TRIANGLES, np.zeros(3), HEAD) is None


def test_no_opening_is_found_without_a_surface() -> None:
    assert find_eye_opening(skin(), TRIANGLES, np.array([9.0, 0, 0]), HEAD) is None


def test_rims_shift_to_those_of_a_larger_eye() -> None:
    here, there = opening(skin()), opening(skin(1.2 * WIDTH, 1.5 * HEIGHT))
    chosen, shifts = match_rims(skin(), STILL, here, there, -1, HEAD)
    places = skin()[chosen]
    between = np.abs(places[:, 0]) < 0.8 * WIDTH
    assert between.sum() > 20
    upwards = np.where(places[:, 1] > 0, 0.5, -0.5) * HEIGHT * np.sqrt(1 - (places[:, 0] / WIDTH).clip(-1, 1) ** 2)
    along = 0.2 * places[:, 0] - 0.05 * (places[:, 0] + WIDTH)  # half at the inner corner, which is not displaced
    np.testing.assert_allclose(shifts[between], np.column_stack([along, upwards, 0 * upwards])[between], atol=0.02)
    assert (places[:, 2] > -0.2).all()  # none on the bottom of the socket


@pytest.mark.parametrize("inner", [0, -1])
def test_the_inner_corner_is_halfway_between_the_opening_and_the_displacement(inner: int) -> None:
    here = opening(skin())
    displacement = STILL + np.array([0.06, 0, 0])
    chosen, shifts = match_rims(skin(), displacement, here, here, inner, HEAD)
    across = skin()[chosen, 0]
    corners = np.abs(across) > WIDTH - 0.02
    at_inner = corners & (across * (2 * inner + 1) < 0)
    np.testing.assert_allclose(shifts[at_inner, 0], 0.03, atol=0.01)
    np.testing.assert_allclose(shifts[corners & ~at_inner, 0], 0, atol=0.01)


@pytest.mark.parametrize(("share", "corresponds"), [(0.4, False), (0.5, True)])
def test_openings_of_very_different_size_do_not_correspond(share: float, corresponds: bool) -> None:
    here, there = opening(skin()), opening(skin(WIDTH, share * HEIGHT))
    chosen, shifts = match_rims(skin(), STILL, here, there, 0, HEAD)
    assert (len(chosen) > 0) == corresponds
    assert shifts.shape == (len(chosen), 3)
