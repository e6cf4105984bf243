# SPDX-License-Identifier: GPL-3.0-or-later
"""Joints of an outfit's own bones move along with it."""

from __future__ import annotations

import numpy as np
import pytest
from bent_tube import tube
from scipy.spatial.transform import Rotation

import zoomout_core as zo

TAIL = tube(around=12, along=41)
JOINTS = np.array([[0, 0, z] for z in (1.0, 3, 5)])
TURN = Rotation.from_rotvec([0.4, -1.1, 0.7])


def bend(points: np.ndarray, radius: float = 4.0) -> np.ndarray:
    """Bend along a circle: heights become angles."""
    x, y, z = np.asarray(points).T
    return np.stack([radius - (radius - x) * np.cos(z / radius), y, (radius - x) * np.sin(z / radius)], axis=1)


def test_joints_inside_a_tail_stay_inside_when_it_bends() -> None:
    moved = zo.move_joints(TAIL, bend(TAIL.vertices), JOINTS)
    np.testing.assert_allclose(moved.positions, bend(JOINTS), atol=0.02)
    for z, rotation in zip(JOINTS[:, 2], moved.rotations, strict=True):
        np.testing.assert_allclose(rotation @ [0, 0, 1], [np.sin(z / 4), 0, np.cos(z / 4)], atol=0.02)


def test_a_similarity_moves_joints_exactly() -> None:
    moved = zo.move_joints(TAIL, 30 * TURN.apply(TAIL.vertices) + [500, 0, 1], JOINTS)
    np.testing.assert_allclose(moved.positions, 30 * TURN.apply(JOINTS) + [500, 0, 1])
    np.testing.assert_allclose(moved.rotations, np.broadcast_to(TURN.as_matrix(), (3, 3, 3)), atol=1e-9)


def test_only_the_surroundings_of_a_joint_move_it() -> None:
    lifted = TAIL.vertices + np.where(TAIL.vertices[:, 2:] > 4, [0, 0, 1.0], 0)
    moved = zo.move_joints(TAIL, lifted, JOINTS)
    np.testing.assert_allclose(moved.positions - JOINTS, [[0, 0, 0], [0, 0, 0], [0, 0, 1]], atol=1e-9)


def test_few_vertices_or_no_joints_are_accepted() -> None:
    strand = zo.Lines([[0, 0, 0], [0, 0, 1.0]], [[0, 1]])
    np.testing.assert_allclose(zo.move_joints(strand, strand.vertices + 1, [[0, 0, 0.5]]).positions, [[1, 1, 1.5]])
    assert zo.move_joints(TAIL, TAIL.vertices, np.zeros((0, 3))).positions.shape == (0, 3)


@pytest.mark.parametrize(
    ("vertices", "joints"), [(np.zeros((2, 3)), JOINTS), (np.full_like(TAIL.vertices, np.nan), JOINTS)]
)
def test_invalid_positions_are_refused(vertices: np.ndarray, joints: np.ndarray) -> None:
    with pytest.raises(ValueError, match="give finite ones"):
        zo.move_joints(TAIL, vertices, joints)
