# SPDX-License-Identifier: GPL-3.0-or-later
"""A target's motion is compared with its source's, in leg lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import is_warning
from zoomout_core.transfer.rigging.motion import MotionCheck, PlayedMotion, SkinnedBody, check_motions, note_on_motions

UP = np.array([0.0, 1.0, 0.0])
# Hips with a triangle on them, a foot with one on the ground, and a hand far from the hips.
REST = np.array(
    [[0, 1, 0], [0.2, 1, 0], [0, 1.2, 0], [0, 0, 0], [0.2, 0, 0], [0, 0, 0.2], [1, 1, 0], [1.1, 1, 0], [1, 1.1, 0]]
)
HIPS, FOOT, HAND = range(3)
PARENTS = np.array([-1, HIPS, HIPS])
SIZE, SECONDS, FRAMES = 0.5, 0.1, 5


def body(size: float = 1.0) -> SkinnedBody:
    weights = csr_array(np.repeat(np.eye(3), 3, axis=0))
    return SkinnedBody(size * REST, weights, size * np.array([[0.0, 1, 0], [0, 0.1, 0], [1, 1, 0]]))


def moving(joint: int = FOOT, *places: np.ndarray) -> np.ndarray:
    """(f, 3, 3, 4) transforms of joints, of which one moves from place to place evenly."""
    poses = np.tile(np.eye(4)[:3], (FRAMES, 3, 1, 1))
    if places:
        poses[:, joint, :, 3] = np.linspace(*places, FRAMES)
    return poses


def check(of_source: np.ndarray, of_target: np.ndarray) -> MotionCheck:
    surface_map = SurfaceMap.from_vertices(np.arange(9), Surface(REST, np.arange(9).reshape(3, 3)))
    motion = PlayedMotion("Walk", SECONDS, of_source, of_target)
    (found,) = check_motions(body(), body(SIZE), surface_map, PARENTS, UP, [motion])
    return found


@pytest.mark.parametrize("place", [[2, 0, 0], [0, 0.5, 0], [0, -0.3, 0]], ids=["slides", "lifts", "sinks"])
def test_scaled_motion_of_the_source_has_no_faults(place: list[float]) -> None:
    still = np.zeros(3)
    found = check(moving(FOOT, still, np.array(place)), moving(FOOT, still, SIZE * np.array(place)))
    assert found == MotionCheck("Walk", *(pytest.approx(0, abs=1e-9) for _ in range(4)))
    assert not found.faults


def test_sliding_sinking_and_floating_are_in_leg_lengths() -> None:
    still = np.zeros(3)
    slides = check(moving(), moving(FOOT, still, np.array([0.2, 0, 0])))
    assert slides.sliding == pytest.approx(0.2 / SIZE / (SECONDS * (FRAMES - 1)))
    assert check(moving(), moving(FOOT, still, np.array([0, -0.1, 0]))).sinking == pytest.approx(0.1 / SIZE)
    floats = check(moving(), moving(FOOT, still, np.array([0, 0.1, 0])))
    assert floats.floating == pytest.approx(0.1 / SIZE)
    assert "slide" in slides.faults[0]
    assert [is_warning(each) for each in note_on_motions([floats])] == [True]


def test_a_walk_in_place_may_have_another_speed() -> None:
    still, step = np.zeros(3), np.array([1.0, 0, 0])
    assert check(moving(FOOT, still, step), moving(FOOT, still, 0.8 * SIZE * step)).sliding == pytest.approx(0)
    assert check(moving(FOOT, still, step), moving(FOOT, still, 0.2 * SIZE * step)).sliding > 0.1


def test_a_hand_that_leaves_the_hips_is_found() -> None:
    still, to_hips = np.zeros(3), np.array([-0.9, 0, 0])
    reaches = moving(HAND, still, to_hips)
    assert check(reaches, moving(HAND, still, SIZE * to_hips)).parting == pytest.approx(0, abs=1e-9)
    found = check(reaches, moving(HAND, still, 0.5 * SIZE * to_hips))
    assert found.parting == pytest.approx(0.45, abs=0.02)
    assert "apart" in found.faults[0]


def test_ground_is_where_the_feet_of_the_source_mostly_are() -> None:
    higher = np.tile([0, 0.2, 0], (2, 1))
    assert check(moving(FOOT, *higher), moving(FOOT, *2 * SIZE * higher)).floating == pytest.approx(0.2)
    assert check(moving(FOOT, *higher), moving()).sinking == pytest.approx(0.2)


def test_a_body_on_the_ground_does_not_float_where_the_source_sinks() -> None:
    sinks = moving()
    sinks[-1, FOOT, 1, 3] = -0.3
    assert check(sinks, moving()).floating == pytest.approx(0)
    lifted = moving()
    lifted[-1, FOOT, 1, 3] = 0.1
    assert check(sinks, lifted).floating == pytest.approx(0.1 / SIZE)


def test_a_body_without_high_joints_is_measured_by_its_height() -> None:
    flat = replace(body(), joints=np.zeros((3, 3)))
    surface_map = SurfaceMap.from_vertices(np.arange(9), Surface(REST, np.arange(9).reshape(3, 3)))
    motion = PlayedMotion("Walk", SECONDS, moving(), moving(FOOT, np.zeros(3), np.array([0, 0.6, 0])))
    (found,) = check_motions(flat, flat, surface_map, PARENTS, UP, [motion])
    assert found.floating == pytest.approx(0.6 / 1.2)
