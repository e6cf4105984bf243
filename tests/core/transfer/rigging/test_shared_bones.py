# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones of a second source hang from the right bones of a target."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.transfer.rigging.bone_pairs import Skeleton
from zoomout_core.transfer.rigging.shared_bones import SharedBones, share_bones

# Vertices of a body, the back of a head and its face; the face is largest.
OWN = np.repeat(np.eye(3), [10, 2, 6], axis=0)
PART = OWN[:, 1] + OWN[:, 2]
TARGET = Skeleton(("Spine", "Head", "Face"), np.array([-1, 0, 1]), np.zeros((3, 3)))


def share(names: tuple[str, ...], parents: list[int], weights: np.ndarray) -> SharedBones:
    bones = Skeleton(names, np.array(parents), np.zeros((len(names), 3)))
    return share_bones(bones, TARGET, csr_array(weights), csr_array(OWN), PART, np.ones(len(PART)))


def test_bones_without_a_shared_one_above_hang_from_the_first_bone_of_the_part() -> None:
    shared = share(("bone", "jaw"), [-1, 0], np.column_stack([OWN[:, 0] + OWN[:, 1], OWN[:, 2]]))
    assert shared.added.tolist() == [1]
    assert shared.parents.tolist() == [1]


def test_bones_hang_from_shared_bones_of_the_part_across_others() -> None:
    # Face is shared, and helper moves nothing.
    weights = np.column_stack([OWN[:, 0], OWN[:, 1], 0 * OWN[:, 1], OWN[:, 2]])
    shared = share(("Spine", "Face", "helper", "jaw"), [-1, 0, 1, 2], weights)
    assert shared.partners.tolist() == [0, 2, -1, -1]
    assert (shared.added.tolist(), shared.parents.tolist()) == ([3], [2])
    np.testing.assert_allclose(shared.weights.toarray(), np.column_stack([OWN[:, 0], 0 * PART, OWN[:, 1], OWN[:, 2]]))
