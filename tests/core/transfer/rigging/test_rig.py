# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigs move into bodies of other proportions."""

from __future__ import annotations

import numpy as np
import pytest
from bent_tube import tube
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.transfer.rigging.rig import RIG, Deformation, follow_longer_bones, joints_of_bones
from zoomout_core.transfer.rigging.rig import place_joints as place_along
from zoomout_core.transfer.rigging.symmetric_joints import SYMMETRIC_JOINTS
from zoomout_core.tuning import retune

LEG = tube(around=12, along=81)
# A chain in its axis with a bend, and a pole target far in front of the bend.
CHAIN = np.array([[0, 0, 1.0], [0, 0.05, 3.0], [0, 0, 5.0], [0, 9.0, 3.0]])
PARENTS = np.array([-1, 0, 1, -1])
TURN = Rotation.from_rotvec([0.4, -1.1, 0.7])


def place_joints(
    body: zo.Surface, vertices: np.ndarray, joints: np.ndarray, parents: np.ndarray, target: zo.Surface | None = None
) -> zo.MovedJoints:
    """Move joints along with the vertices of a body, which are those of the target unless one is given."""
    target = body.with_vertices(vertices) if target is None else target
    unit = float(np.sqrt(body.area))
    return place_along(Deformation(body.vertices, vertices, body.vertex_areas, unit, target), joints, parents)


def bulge(points: np.ndarray, height: float, shift: float) -> np.ndarray:
    """Slide points along the axis around a height."""
    return points + np.outer(shift * np.exp(-((points[:, 2] - height) ** 2) / 0.5), [0, 0, 1.0])


def twin(points: np.ndarray) -> np.ndarray:
    """Points and their mirror images in the plane x = 0, three units to each side."""
    points = points + np.array([3.0, 0, 0])
    return np.concatenate([points, points * [-1, 1, 1]])


def legs() -> zo.Surface:
    """Two mirrored tubes."""
    triangles = LEG.triangles
    return zo.Surface(twin(LEG.vertices), np.concatenate([triangles, triangles[:, ::-1] + len(LEG.vertices)]))


def test_a_similarity_moves_a_rig_exactly() -> None:
    moved = place_joints(LEG, 30 * TURN.apply(LEG.vertices) + [500, 0, 1], CHAIN, PARENTS)
    np.testing.assert_allclose(moved.positions, 30 * TURN.apply(CHAIN) + [500, 0, 1])
    np.testing.assert_allclose(moved.rotations, np.broadcast_to(TURN.as_matrix(), (4, 3, 3)), atol=1e-9)


def test_joints_keep_their_place_in_longer_and_thicker_limbs() -> None:
    stretch = np.array([1.6, 1.6, 0.8])
    moved = place_joints(LEG, LEG.vertices * stretch, CHAIN[:3], PARENTS[:3])
    np.testing.assert_allclose(moved.positions, CHAIN[:3] * stretch, atol=0.03)


def test_a_rig_is_moved_along_a_match_of_other_triangles() -> None:
    target = tube(around=16, along=101)
    map_of_rings = zo.match_by_proximity(LEG, target)
    moved = zo.move_rig(map_of_rings, LEG, target.with_vertices(target.vertices * 2), CHAIN[:3], PARENTS[:3])
    np.testing.assert_allclose(moved.positions, 2 * CHAIN[:3], atol=0.05)


def test_joints_on_a_coarse_target_follow_images_of_vertices() -> None:
    target = tube(around=8, along=21)
    images = zo.match_by_proximity(LEG, target)
    thicker = target.with_vertices(target.vertices * [1.5, 1.5, 1])
    moved = zo.move_rig(images, LEG, thicker, CHAIN[:3], PARENTS[:3]).positions
    np.testing.assert_allclose(moved, CHAIN[:3] * [1.5, 1.5, 1], atol=0.05)
    with retune(RIG, coarse=0.0):
        assert np.abs(zo.move_rig(images, LEG, thicker, CHAIN[:3], PARENTS[:3]).positions - moved).max() > 1e-6


def test_joints_at_one_place_stay_together() -> None:
    joints = np.concatenate([CHAIN[:3], CHAIN[1:2]])
    noise = np.random.default_rng(0).normal(0, 0.05, LEG.vertices.shape)
    moved = place_joints(LEG, LEG.vertices + noise, joints, np.array([-1, 0, 1, -1]))
    np.testing.assert_allclose(moved.positions[3], moved.positions[1])


def test_roll_follows_the_surface_and_direction_the_joints() -> None:
    twist = Rotation.from_rotvec([0, 0, 0.5])
    bent = twist.apply(LEG.vertices) + np.outer(LEG.vertices[:, 2], [0.1, 0, 0])
    moved = place_joints(LEG, bent, CHAIN[[0, 2]], np.array([-1, 0]))
    arm = moved.positions[1] - moved.positions[0]
    np.testing.assert_allclose(moved.rotations[0] @ [0, 0, 1], arm / np.linalg.norm(arm), atol=2e-3)
    sideways = moved.rotations[0] @ [1, 0, 0]
    assert np.degrees(np.arccos(sideways @ twist.apply([1, 0, 0]))) < 8


def test_a_joint_between_two_bones_keeps_its_place_between_their_ends() -> None:
    slid = bulge(LEG.vertices, 3, 0.4)
    free = place_joints(LEG, slid, CHAIN[:3], np.full(3, -1)).positions[1, 2]
    with retune(RIG, between=0.0, along=0.0):
        alone = place_joints(LEG, slid, CHAIN[:3], PARENTS[:3]).positions[1, 2]
    moved = place_joints(LEG, slid, CHAIN[:3], PARENTS[:3]).positions[1, 2]
    assert alone == pytest.approx(free)
    assert 0 < moved - 3 < 0.8 * (free - 3)


def test_twist_bones_beside_a_chain_do_not_end_it() -> None:
    slid = bulge(LEG.vertices, 3, 0.4)
    joints = np.concatenate([CHAIN[:3], [[0, 0, 4.0], [0, 0, 5.8]]])
    parents = np.array([-1, 0, 1, 1, 2])
    with_twist = place_joints(LEG, slid, joints, parents).positions[1, 2]
    with retune(RIG, between=0.0):
        without = place_joints(LEG, slid, joints, parents).positions[1, 2]
    assert abs(with_twist - 3) < 0.8 * abs(without - 3)


def test_off_axis_joint_follows_its_whole_cross_section() -> None:
    joint = np.array([[0.5 * LEG.vertices[:, 0].max(), 0, 3.0]])
    near = np.exp(-((LEG.vertices - [LEG.vertices[:, 0].max(), 0, 3.0]) ** 2).sum(axis=1) / 0.5)
    swollen = LEG.vertices + np.outer(near, [1.0, 0, 0])

    def aside() -> float:
        return float((place_joints(LEG, swollen, joint, np.array([-1])).positions - joint)[0, 0])

    with retune(RIG, falloff=12.0):
        by_patch = aside()
    assert 0 < aside() < 0.8 * by_patch


def test_bones_keep_their_lengths_on_noisy_surfaces() -> None:
    joints, parents = np.array([[0, 0, z] for z in (1.0, 2, 3, 4, 5)]), np.arange(-1, 4)
    noise = np.random.default_rng(1).normal(0, 0.3, LEG.vertices.shape)

    def spread() -> float:
        return float(np.diff(place_joints(LEG, LEG.vertices + noise, joints, parents).positions[:, 2]).std())

    with retune(RIG, between=0.0, along=0.0):
        alone = spread()
    with retune(RIG, between=0.0):
        assert spread() < 0.9 * alone


def test_joint_just_below_the_skin_stays_there() -> None:
    """It is not moved by bones to deeper joints."""
    joints, parents = np.array([LEG.vertices[500], [0, 0, 1.0], [0, 0, 5.8]]), np.array([1, -1, 1])
    slid = bulge(LEG.vertices, joints[0, 2], 0.5)

    def off() -> float:
        return float(np.linalg.norm(place_joints(LEG, slid, joints, parents).positions[0] - slid[500]))

    with retune(RIG, shallow=1.0):
        deep = off()
    assert off() < 0.5 * deep


def test_a_pole_target_follows_a_wide_part_of_the_surface() -> None:
    noise = np.random.default_rng(2).normal(0, 0.02, LEG.vertices.shape)
    moved = place_joints(LEG, LEG.vertices + noise, CHAIN, PARENTS)
    assert np.linalg.norm(moved.positions[3] - CHAIN[3]) < 0.2


def test_a_symmetric_rig_stays_symmetric() -> None:
    body, joints = legs(), twin(CHAIN[:3])
    parents = np.concatenate([PARENTS[:3], np.array([-1, 3, 4])])
    noise = np.random.default_rng(3).normal(0, 0.03, body.vertices.shape)
    moved = place_joints(body, body.vertices + noise, joints, parents)
    heights = moved.positions[:, 2]
    np.testing.assert_allclose(heights[:3] - heights[0], heights[3:] - heights[3], atol=0.01)
    np.testing.assert_allclose(
        *(np.linalg.norm(np.diff(each, axis=0), axis=1) for each in np.split(moved.positions, 2))
    )
    with retune(SYMMETRIC_JOINTS, max_distance=0.0):
        lengths = [
            np.linalg.norm(np.diff(each, axis=0), axis=1)
            for each in np.split(place_joints(body, body.vertices + noise, joints, parents).positions, 2)
        ]
    assert np.abs(lengths[0] - lengths[1]).max() > 1e-3


def test_an_asymmetric_body_keeps_its_asymmetry() -> None:
    body, joints = legs(), twin(CHAIN[:3])
    parents = np.concatenate([PARENTS[:3], np.array([-1, 3, 4])])
    lifted = body.vertices + np.outer(body.vertices[:, 0] > 0, [0, 0, 1.0])
    moved = place_joints(body, lifted, joints, parents)
    np.testing.assert_allclose(moved.positions, joints + np.outer(joints[:, 0] > 0, [0, 0, 1.0]), atol=0.05)


def test_sliding_along_one_leg_is_averaged_with_the_other() -> None:
    body, joints = legs(), twin(CHAIN[:3])
    parents = np.concatenate([PARENTS[:3], np.array([-1, 3, 4])])
    right = body.vertices[:, 0] > 0
    slid = np.where(right[:, None], bulge(body.vertices, 3, 0.4), body.vertices)
    moved = place_joints(body, slid, joints, parents).positions
    np.testing.assert_allclose(moved[3:], moved[:3] * [-1, 1, 1], atol=0.05)
    thicker = np.where(right[:, None], (slid - [3, 0, 0]) * [2.0, 2, 1] + [3, 0, 0], slid)
    apart = place_joints(body, thicker, joints, parents).positions
    assert abs(apart[4, 2] - apart[1, 2]) > abs(moved[4, 2] - moved[1, 2]) + 0.1


def test_a_map_that_is_wrong_on_one_side_keeps_joints_of_a_symmetric_target_symmetric() -> None:
    body, joints = legs(), twin(CHAIN[:3])
    parents = np.concatenate([PARENTS[:3], np.array([-1, 3, 4])])
    right = body.vertices[:, 0] > 0
    slid = np.where(right[:, None], bulge(body.vertices, 3, 0.4), body.vertices)
    torn = np.where(right[:, None], (slid - [3, 0, 0]) * [2.0, 2, 1] + [3, 0, 0], slid)
    moved = place_joints(body, torn, joints, parents, target=body).positions
    np.testing.assert_allclose(moved[3:], moved[:3] * [-1, 1, 1], atol=0.05)


def test_a_chain_along_a_line_is_not_mirrored_end_to_end() -> None:
    joints, parents = np.array([[0, 0, z] for z in (1.0, 3.0, 5.0)]), np.array([-1, 0, 1])
    moved = place_joints(LEG, bulge(LEG.vertices, 5, 0.1), joints, parents)
    assert moved.positions[2, 2] - moved.positions[1, 2] > moved.positions[1, 2] - moved.positions[0, 2] + 0.02


def test_heads_are_parented_to_tails() -> None:
    heads, tails = np.zeros((2, 3)), np.ones((2, 3))
    joints, parents = joints_of_bones(heads, tails, np.array([-1, 0]))
    np.testing.assert_array_equal(joints, [*heads, *tails])
    assert parents.tolist() == [-1, 2, 0, 1]


def test_bones_along_a_longer_bone_follow_it() -> None:
    heads, tails = np.array([[0, 0, 0], [0, 0, 1], [0, 0.3, 1.0]]), np.array([[0, 0, 4], [0, 0, 2], [0, 0.3, 2.0]])
    moved = heads + np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0]])
    ends = tails + np.array([[4, 0, 0], [0, 0, 0], [1, 0, 0]])
    turns = np.stack([TURN.as_matrix(), np.eye(3), np.eye(3)])
    found = follow_longer_bones(heads, tails, moved, ends, turns)
    np.testing.assert_allclose(found[0], [[0, 0, 0], [1, 0, 1], [1, 0.3, 1]])
    np.testing.assert_allclose(found[1], [[4, 0, 4], [2, 0, 2], [1, 0.3, 2]])
    np.testing.assert_allclose(found[2], [turns[0], turns[0], np.eye(3)])


@pytest.mark.parametrize(
    ("joints", "parents", "message"),
    [
        ([[0, 0, np.nan]], [-1], "not finite"),
        ([[0, 0, 1.0]], [1], "the number of its parent"),
        ([[0, 0, 1.0]], [-1, 0], "the number of its parent"),
        ([[0, 0, 1.0], [0, 0, 2.0]], [1, 0], "form a cycle"),
    ],
)
def test_invalid_rigs_are_refused(joints: list, parents: list, message: str) -> None:
    same = zo.SurfaceMap.from_vertices(np.arange(len(LEG.vertices)), LEG)
    with pytest.raises(ValueError, match=message):
        zo.move_rig(same, LEG, LEG, joints, parents)


def test_rig_without_joints_is_accepted() -> None:
    assert place_joints(LEG, LEG.vertices, np.zeros((0, 3)), np.zeros(0, dtype=np.int64)).positions.shape == (0, 3)
