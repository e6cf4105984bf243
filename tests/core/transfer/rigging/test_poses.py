# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses rotate each bone against its parent, about any joints, and the most different ones are played."""

from __future__ import annotations

import numpy as np
import pytest
from bent_tube import PARENTS

from zoomout_core.transfer.rigging.poses import (
    MAX_FRAMES,
    distinct_poses,
    extend_poses,
    extreme_poses,
    find_limbs,
    gentle_poses,
    poses_about,
)
from zoomout_core.transfer.rigging.poses import POSES as POSE_TUNING

HEADS = np.array([[0, 0, 0], [0, 0, 2], [0, 0, 4.0]])
POSES = extreme_poses(HEADS, PARENTS)


def test_poses_about_other_heads_are_equivalent() -> None:
    moved = HEADS * [1, 1, 1.5] + [0, 0.2, 0.1]
    np.testing.assert_allclose(poses_about(POSES, HEADS, moved, PARENTS), extreme_poses(moved, PARENTS), atol=1e-9)
    shifted = POSES.copy()
    shifted[:, :, :, 3] += [0, 0, 2.0]
    np.testing.assert_allclose(
        poses_about(shifted, HEADS, moved, PARENTS) - poses_about(POSES, HEADS, moved, PARENTS),
        shifted - POSES,
        atol=1e-9,
    )


def test_poses_turn_each_bone_by_one_angle_about_its_head() -> None:
    for transforms in POSES:
        for bone, parent in enumerate(PARENTS):
            above = np.eye(3, 4) if parent < 0 else transforms[parent]
            head = HEADS[bone]
            moved = [each[:, :3] @ head + each[:, 3] for each in (transforms[bone], above)]
            np.testing.assert_allclose(moved[0], moved[1], atol=1e-12)
            turn = transforms[bone][:, :3] @ above[:, :3].T
            angle = np.degrees(np.arccos((np.trace(turn) - 1) / 2))
            assert angle == pytest.approx(POSE_TUNING.angle)
    assert len(np.unique(POSES.round(6), axis=0)) == len(POSES) == 12


def test_bones_may_come_in_any_order() -> None:
    order = np.array([2, 0, 1])
    parents = np.array([{-1: -1, 0: 1, 1: 2}[PARENTS[bone]] for bone in order])
    np.testing.assert_allclose(extreme_poses(HEADS[order], parents), POSES[:, order])


def test_the_most_different_frames_of_an_animation_are_played() -> None:
    turns = np.concatenate([np.full(90, 0.01), [1.0, 2.0, -1.0]])
    frames = np.array([extreme_poses(HEADS, PARENTS)[0]] * len(turns))
    frames[:, 2] = np.eye(3, 4)
    frames[:, 2, 0, 3] = turns
    chosen = distinct_poses(frames, HEADS)
    assert len(chosen) == MAX_FRAMES
    assert set(chosen[:, 2, 0, 3]) == set(turns)
    np.testing.assert_array_equal(distinct_poses(frames[:3], HEADS), frames[:3])
    assert distinct_poses(frames[:0], HEADS).shape == (0, 3, 3, 4)


# Hips, chest and head; an arm, an elbow, a hand and a finger on either side.
NAMES = ["hips", "chest", "head", *(f"{part}{side}" for side in "LR" for part in ("arm", "elbow", "hand", "finger"))]
BODY = np.array(
    [[0, 0, 0], [0, 0.4, 0], [0, 0.7, 0], *([x * side, 0.5, 0] for side in (1, -1) for x in (0.1, 0.4, 0.7, 0.75))]
)
ABOVE = np.array([-1, 0, 1, 1, 3, 4, 5, 1, 7, 8, 9])


@pytest.mark.parametrize("up", [1, 2])
def test_limbs_are_found(up: int) -> None:
    heads = BODY if up == 1 else BODY[:, [0, 2, 1]]
    limbs = find_limbs(7 * heads, ABOVE, up)
    assert [name for name, is_root in zip(NAMES, limbs.root, strict=True) if is_root] == ["armL", "armR"]
    assert [name for name, inner in zip(NAMES, limbs.inner, strict=True) if inner] == NAMES[4:7] + NAMES[8:]
    np.testing.assert_array_equal(limbs.side, [0, 0, 0, 1, 1, 1, 1, -1, -1, -1, -1])


@pytest.mark.parametrize("up", [1, 2])
def test_in_gentle_poses_limbs_swing_and_bend_but_not_fingers(up: int) -> None:
    heads = BODY if up == 1 else BODY[:, [0, 2, 1]]
    poses = gentle_poses(heads, ABOVE, up)
    turned = np.zeros(len(NAMES), dtype=bool)
    for transforms in poses:
        for joint, parent in enumerate(ABOVE):
            above = np.eye(3) if parent < 0 else transforms[parent][:, :3]
            turned[joint] |= not np.allclose(transforms[joint][:, :3], above)
    assert [name for name, turns in zip(NAMES, turned, strict=True) if turns] == [
        "chest",
        "head",
        "armL",
        "elbowL",
        "armR",
        "elbowR",
    ]
    hands = np.einsum("fxy,y->fx", poses[:, 5, :, :3], heads[5]) + poses[:, 5, :, 3]
    reached = hands - heads[5]
    assert np.abs(reached[:, up]).max() > 0.4  # lifted to the side
    assert len(np.unique(poses.round(6), axis=0)) == len(poses)


def test_further_joints_move_with_their_parents() -> None:
    parents = np.array([*PARENTS, 3 + 1, 2])
    extended = extend_poses(POSES, parents)
    np.testing.assert_array_equal(extended[:, :3], POSES)
    np.testing.assert_array_equal(extended[:, 3], POSES[:, 2])
    np.testing.assert_array_equal(extended[:, 4], POSES[:, 2])
