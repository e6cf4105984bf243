# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones move vertices as Blender's armatures do, by blended matrices or dual quaternions."""

import numpy as np
from bent_tube import bend, tube, weights_of
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.mesh.affine_maps import transform_points
from zoomout_core.transfer.rigging.skinning import renumber_bones, skinning_matrices

BOTH = csr_array(np.array([[0.5, 0.5]]))


def _rotations(*degrees, about="z", shift=(0, 0, 0)):
    turns = Rotation.from_euler(about, np.array(degrees)[:, None], degrees=True).as_matrix()
    return Similarities(np.ones(len(degrees)), turns, np.tile(np.array(shift, float), (len(degrees), 1)))


def test_vertex_of_one_bone_follows_it():
    transforms, points = bend(scale=1.5), np.array([[0.1, 0.2, 0.5], [0.3, 0.1, 5.0]])
    alone = csr_array(np.array([[0.4, 0, 0], [0, 0, 3.0]]))  # weights need not sum to one
    for preserve_volume in (False, True):
        found = transform_points(skinning_matrices(transforms, alone, preserve_volume=preserve_volume), points)
        wanted = [transforms[i : i + 1](points[j : j + 1][None])[0, 0] for j, i in enumerate((0, 2))]
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_vertex_without_weights_has_no_matrix():
    none = csr_array(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    none.eliminate_zeros()
    for preserve_volume in (False, True):
        matrices = skinning_matrices(bend(), none, preserve_volume=preserve_volume)
        assert not matrices[0].any()
        assert matrices[1].any()


def test_matrices_collapse_where_dual_quaternions_keep_the_volume():
    matrices = skinning_matrices(_rotations(0, 160), BOTH)
    rigid = skinning_matrices(_rotations(0, 160, shift=(0.5, 0, 0)), BOTH, preserve_volume=True)
    assert np.linalg.det(matrices[0, :, :3]) < 0.1
    assert np.isclose(np.linalg.det(rigid[0, :, :3]), 1)
    np.testing.assert_allclose(rigid[0, :, :3], Rotation.from_euler("z", 80, degrees=True).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rigid[0, :, 3], _rotations(80, shift=(0.5, 0, 0)).translation[0], atol=0.2)


def test_dual_quaternions_are_mixed_by_weight():
    unequal = csr_array(np.array([[0.8, 0.2]]))
    turn = skinning_matrices(_rotations(0, 100), unequal, preserve_volume=True)[0, :, :3]
    half = np.radians(50)
    angle = 2 * np.arctan2(0.2 * np.sin(half), 0.8 + 0.2 * np.cos(half))
    np.testing.assert_allclose(turn, Rotation.from_euler("z", angle).as_matrix(), atol=1e-12)


def test_dual_quaternions_are_blended_along_the_shorter_arc():
    # 170 and 190 degrees differ by 20, but scipy's quaternions for them have opposite signs.
    matrices = skinning_matrices(_rotations(170, 190), BOTH, preserve_volume=True)
    np.testing.assert_allclose(matrices[0, :, :3], Rotation.from_euler("z", 180, degrees=True).as_matrix(), atol=1e-9)


def test_bones_of_one_number_are_merged_and_others_dropped():
    weights = csr_array(np.array([[0.5, 0.2, 0.2, 0.1], [0, 0, 0, 1.0]], dtype=np.float32))
    found = renumber_bones(weights, np.array([2, 0, 0, -1]), 3)
    np.testing.assert_allclose(found.toarray(), [[0.4, 0, 0.5], [0, 0, 0]], atol=1e-7)
    assert found.dtype == np.float64
    assert renumber_bones(csr_array((2, 0)), np.zeros(0, dtype=np.int64), 3).shape == (2, 3)


def test_weights_are_not_modified():
    weights = weights_of(tube().vertices)
    before = weights.data.copy()
    skinning_matrices(bend(), weights)
    np.testing.assert_array_equal(weights.data, before)
