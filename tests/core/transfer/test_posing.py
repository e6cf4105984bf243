# SPDX-License-Identifier: GPL-3.0-or-later
"""A body is taken to the pose of another shape by its joints."""

from __future__ import annotations

import numpy as np
from bent_tube import PARENTS, bend, pose_surface, tube, weights_of
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from zoomout_core.transfer.dressing.posing import pose_like
from zoomout_core.transfer.skinning import blend_matrices, transform_points

# A fourth joint shares what the third one moves, so that the third has a direction.
HEADS = np.array([[0, 0, 0.0], [0, 0, 2], [0, 0, 4], [0, 0, 5]])
CHAIN = np.append(PARENTS, 2)


def chain_weights(points: np.ndarray) -> csr_array:
    """(n, 4) weights of the joints."""
    weights = weights_of(points).toarray()
    return csr_array(np.column_stack([weights[:, :2], 0.5 * weights[:, 2:], 0.5 * weights[:, 2:]]))


def test_a_body_is_taken_to_another_pose() -> None:
    body = tube()
    bent = pose_surface(body, bend((0, 0, 0), (60, 0, 0))).vertices
    # It also stands elsewhere, and is twice as large.
    shape = 2 * bent @ Rotation.from_euler("z", 70, degrees=True).as_matrix().T + [5, 1, 0]
    weights = chain_weights(body.vertices)
    transforms = pose_like(body, shape, weights, CHAIN, HEADS)
    assert transforms is not None
    moved = transform_points(blend_matrices(transforms, weights), body.vertices)
    apart = [np.linalg.norm(each[[0, 8, 320, -1]][:, None] - each[[0, 8, 320, -1]], axis=2) for each in (moved, bent)]
    np.testing.assert_allclose(*apart, atol=0.4)  # of a length of 6


def test_builds_in_the_same_pose_stay() -> None:
    body = tube()
    assert pose_like(body, body.vertices * [1.6, 1.2, 0.9], chain_weights(body.vertices), CHAIN, HEADS) is None
    slightly = pose_surface(body, bend((10, 0, 0), (5, 0, 0))).vertices
    assert pose_like(body, slightly, chain_weights(body.vertices), CHAIN, HEADS) is None


def test_joints_turn_where_the_body_bends() -> None:
    """A joint below the bend, as the collarbone is above the shoulder, keeps its direction."""
    body = tube()
    bent = pose_surface(body, bend((0, 0, 0), (60, 0, 0)))
    heads = np.array([[0, 0, 0.0], [0, 0, 3.4], [0, 0, 4], [0, 0, 5]])
    weights = chain_weights(body.vertices)
    transforms = pose_like(body, bent.vertices, weights, CHAIN, heads)
    assert transforms is not None
    angles = [np.degrees(Rotation.from_matrix(each[:, :3]).magnitude()) for each in transforms]
    assert angles[1] == angles[0]
    assert angles[2] > angles[1] + 20


def test_what_moves_nothing_has_no_say() -> None:
    body = tube()
    bent = pose_surface(body, bend((0, 0, 0), (60, 0, 0))).vertices
    weights = chain_weights(body.vertices)
    known = pose_like(body, bent, weights, CHAIN, HEADS)
    more = csr_array((weights.data, weights.indices, weights.indptr), shape=(weights.shape[0], 5))
    tassel = np.vstack([HEADS, [[3, 0, 2]]])
    found = pose_like(body, bent, more, np.append(CHAIN, 1), tassel)
    assert known is not None
    assert found is not None
    np.testing.assert_allclose(found[:4], known)
    np.testing.assert_allclose(found[4], known[1], atol=1e-12)
