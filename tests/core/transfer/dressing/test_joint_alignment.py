# SPDX-License-Identifier: GPL-3.0-or-later
"""A map that slides along limbs is corrected by joints, unless armatures place these in other ways."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.dressing.joint_alignment import JOINT_ALIGNMENT, JointPairs, align_joints
from zoomout_core.transfer.rigging.bone_pairs import Skeleton
from zoomout_core.transfer.rigging.joints import move_joints

# A rod along z with joints in it.
BODY = ball(1.0, radii=(0.15, 0.15, 1), count=3000, seed=1)
HEADS = np.column_stack([np.zeros((9, 2)), np.linspace(-0.8, 0.8, 9)])
PARENTS = np.arange(9) - 1
NAMES = tuple(f"Bone {number}" for number in range(9))
BONES = Skeleton(NAMES, PARENTS, HEADS)
# Where the rod keeps its width, so that a slide leaves it on the skin.
MIDDLE = np.abs(BODY.vertices[:, 2]) < 0.5


def weights(vertices: np.ndarray) -> csr_array:
    """(n, 9) weights of the bones, each of which moves what is between its joint and the next one."""
    bone = np.clip(np.searchsorted(HEADS[:, 2], vertices[:, 2]) - 1, 0, 8)
    return csr_array((np.ones(len(bone)), (np.arange(len(bone)), bone)), shape=(len(bone), 9))


WEIGHTS = weights(BODY.vertices)


def slid(z: np.ndarray) -> np.ndarray:
    """Places along the rod as a map has them that slides by up to 0.1."""
    return z + 0.1 * np.cos(np.pi / 2 * z) ** 2


def on_skin(places: np.ndarray) -> np.ndarray:
    """Places whose distance from the axis is that of the skin."""
    radius = 0.15 * np.sqrt(np.maximum(1 - places[:, 2:] ** 2, 0))
    around = np.linalg.norm(places[:, :2], axis=1, keepdims=True)
    return np.hstack([places[:, :2] * radius / np.maximum(around, 1e-9), places[:, 2:]])


SLID = on_skin(np.column_stack([BODY.vertices[:, :2], slid(BODY.vertices[:, 2])]))


def error(found: np.ndarray, unit: float = 1.0) -> float:
    """The mean distance from the truth in the middle."""
    return float(np.linalg.norm(found / unit - BODY.vertices, axis=1)[MIDDLE].mean())


def align(shape: np.ndarray, after: np.ndarray = HEADS, unit: float = 1.0) -> np.ndarray:
    body = BODY.with_vertices(unit * BODY.vertices)
    return align_joints(body, unit * shape, body, JointPairs(unit * HEADS, unit * after, PARENTS, WEIGHTS))


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_skin_that_slid_along_bones_returns_to_their_joints(unit: float) -> None:
    found = align(SLID, unit=unit)
    assert error(SLID) > 0.06
    assert error(found, unit) < 0.2 * error(SLID)
    np.testing.assert_allclose(on_skin(found / unit), found / unit, atol=0.005)


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_skin_stays_on_the_side_that_faces_its_way(unit: float) -> None:
    """Even if the lining of the body, which faces inwards, is nearer where the rod grows thicker."""
    lining = Surface(0.98 * BODY.vertices, BODY.triangles[:, ::-1])
    skin = Surface.joined([BODY, lining])
    body, skin = (each.with_vertices(unit * each.vertices) for each in (BODY, skin))
    joints = JointPairs(unit * HEADS, unit * HEADS, PARENTS, WEIGHTS)
    found = align_joints(body, unit * SLID, skin, joints)[MIDDLE] / unit
    radius = np.linalg.norm(found[:, :2], axis=1) / (0.15 * np.sqrt(1 - found[:, 2] ** 2))
    assert radius.min() > 0.985


def test_a_right_shape_is_kept() -> None:
    assert error(align(BODY.vertices)) < 1e-3


def test_joints_that_are_off_across_the_bones_are_not_trusted() -> None:
    elsewhere = HEADS + np.array([0.05, 0, 0.1])
    assert error(align(BODY.vertices, elsewhere)) < 0.01
    # Without a distance across the bones, the same joints would move the skin.
    assert error(align(BODY.vertices, HEADS + np.array([0, 0, 0.1]))) > 0.06


def test_skin_slides_no_farther_than_a_bone_in_a_round() -> None:
    lengths = np.linalg.norm(np.diff(HEADS, axis=0), axis=1)
    found = align(BODY.vertices, HEADS + np.array([0, 0, 100]))
    moved = np.linalg.norm(found - BODY.vertices, axis=1)
    assert 0.1 < moved.max() < 1.1 * JOINT_ALIGNMENT.rounds * lengths.max()


def test_few_bones_tell_nothing() -> None:
    few = JointPairs(HEADS[:5], HEADS[:5], PARENTS[:5], WEIGHTS[:, :5])
    assert align_joints(BODY, SLID, BODY, few) is SLID


def test_parts_within_the_body_slide_without_being_put_on_the_skin() -> None:
    ball_inside = ball(0.03, (0, 0, 0.05), count=60, seed=2)
    both = Surface.joined([BODY, ball_inside])
    inside = np.arange(len(both.vertices)) >= len(BODY.vertices)
    shape = np.vstack([SLID, ball_inside.vertices + np.array([0, 0, 0.1])])
    joints = JointPairs(HEADS, HEADS, PARENTS, weights(both.vertices))
    found = align_joints(both, shape, BODY, joints)[inside]
    assert abs(found[:, 2].mean() - 0.05) < 0.03
    assert np.linalg.norm(found[:, :2], axis=1).max() < 0.05


def test_vertices_without_weights_stay() -> None:
    free = csr_array(WEIGHTS.multiply((BODY.vertices[:, 2] < 0)[:, None]))
    joints = JointPairs(HEADS, HEADS, PARENTS, free)
    far = BODY.vertices[:, 2] > 0.6
    np.testing.assert_allclose(align_joints(BODY, SLID, BODY, joints)[far], SLID[far], atol=1e-3)


def test_bones_without_a_partner_count_for_the_one_above() -> None:
    others = Skeleton(NAMES[:4] + NAMES[5:], np.maximum(np.arange(8) - 1, -1), np.delete(HEADS, 4, axis=0) + 1.0)
    pairs = JointPairs.of(BONES, WEIGHTS, others)
    assert pairs.parents.tolist() == [-1, 0, 1, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(pairs.before, pairs.after - 1.0)
    np.testing.assert_allclose(pairs.weights[:, [3]].toarray(), (WEIGHTS[:, [3]] + WEIGHTS[:, [4]]).toarray())


def test_bones_of_the_same_place_only_are_no_partners() -> None:
    others = Skeleton(tuple(f"Other {number}" for number in range(9)), PARENTS, HEADS)
    assert len(JointPairs.of(BONES, WEIGHTS, others).before) == 0


def test_joints_and_shapes_that_are_not_finite_are_refused() -> None:
    broken = np.where(np.arange(9)[:, None] == 3, np.nan, HEADS)
    with pytest.raises(ValueError, match=r"Some joints are not finite: give finite positions \(j, 3\)"):
        align(SLID, broken)
    with pytest.raises(ValueError, match=r"Some joints are not finite: give finite positions \(j, 3\)"):
        move_joints(BODY, SLID, broken)
    with pytest.raises(ValueError, match=r"vertices are of the shape .* or not finite: give finite ones"):
        align(np.where(MIDDLE[:, None], np.nan, SLID))
