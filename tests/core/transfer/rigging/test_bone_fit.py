# SPDX-License-Identifier: GPL-3.0-or-later
"""Bone transforms are recovered from the surface that they posed."""

import numpy as np
import pytest
from bent_tube import LENGTH, PARENTS, bend, pose_surface, tube, weights_of
from scipy.sparse import csr_array, hstack
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.transfer.rigging.bone_fit import estimate_pose, refine_pose
from zoomout_core.transfer.rigging.bone_problem import BONES
from zoomout_core.transfer.rigging.bone_tree import next_above
from zoomout_core.tuning import retune


def _angles(found, wanted):
    return Rotation.from_matrix(found.rotation @ np.swapaxes(wanted.rotation, 1, 2)).magnitude()


def _estimate(surface, moved, weights=None, trust=None, parents=PARENTS):
    weights = weights_of(surface.vertices) if weights is None else weights
    trust = np.ones(len(surface.vertices)) if trust is None else trust
    return estimate_pose(surface.vertices, moved, weights, trust, parents)


@pytest.mark.parametrize("first", [(60, 0, 30), (0, 0, 150), (-120, 40, 0)])
def test_transforms_are_recovered(first):
    surface, transforms = tube(), bend(first)
    pose = _estimate(surface, pose_surface(surface, transforms).vertices + np.array([3.0, -2.0, 10.0]))
    assert _angles(pose.transforms, transforms).max() < 1e-3
    np.testing.assert_allclose(pose.transforms.translation, transforms.translation + np.array([3, -2, 10]), atol=5e-3)
    assert pose.scale == 1


def test_common_scale_is_found_and_one_near_unity_is_ignored():
    surface = tube()
    for scale, found in ((1.6, 1.6), (0.3, 0.3), (1.01, 1.0)):
        pose = _estimate(surface, pose_surface(surface, bend(scale=scale)).vertices)
        assert abs(pose.scale / found - 1) < 0.02
        assert (pose.scale == 1) == (found == 1)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_pose_does_not_depend_on_the_unit_of_the_images(scale):
    surface = tube()
    moved = pose_surface(surface, bend(scale=1.6)).vertices + np.random.default_rng(0).normal(
        0, 0.05, (len(surface.vertices), 3)
    )
    pose, scaled = _estimate(surface, moved), _estimate(surface, scale * moved)
    assert _angles(scaled.transforms, pose.transforms).max() < 1e-6
    assert scaled.bend == pytest.approx(pose.bend)
    np.testing.assert_allclose(scaled.transforms.translation / scale, pose.transforms.translation, atol=1e-6)


def test_bend_distinguishes_rest_from_a_pose():
    surface = tube()
    still = bend((0, 0, 0), (0, 0, 0))
    turn = Rotation.from_euler("xyz", [30, 70, 10], degrees=True).as_matrix()
    elsewhere = 2.5 * surface.vertices @ turn.T + [5, 6, 7]
    for moved in (pose_surface(surface, still).vertices, elsewhere):
        pose = _estimate(surface, moved)
        assert pose.is_rest
        assert pose.bend < 0.1
    np.testing.assert_allclose(pose.common(surface.vertices), elsewhere, atol=1e-6)
    pose = _estimate(surface, pose_surface(surface, bend((30, 0, 0), (0, 0, 0))).vertices)
    assert not pose.is_rest
    assert 12 < pose.bend < 18  # one third of the tube bends against two thirds


def test_wrongly_mapped_points_hardly_count():
    surface, transforms = tube(), bend()
    moved = pose_surface(surface, transforms).vertices
    wrong = np.random.default_rng(0).choice(len(moved), len(moved) // 8, replace=False)
    moved[wrong] += [0.8, 0, 0]
    pose = _estimate(surface, moved)
    with retune(BONES, outlying=1000.0):
        trusting = _estimate(surface, moved)
    assert _angles(pose.transforms, transforms).max() < 0.01
    assert np.abs(pose.transforms.translation - transforms.translation).max() < 0.02
    assert np.abs(trusting.transforms.translation - transforms.translation).max() > 0.05


def test_exact_images_are_all_used():
    surface, transforms = tube(), bend()
    moved = pose_surface(surface, transforms).vertices
    moved[weights_of(surface.vertices).toarray()[:, 2] == 1] += 1e-4  # a whole bone is slightly off
    with retune(BONES, precision=1e-9, rounds=8):
        assert np.isfinite(_estimate(surface, moved).transforms.translation).all()
    assert np.abs(_estimate(surface, moved).transforms.translation - transforms.translation).max() < 1e-3


def test_bone_without_vertices_follows_its_next_ancestor():
    surface, transforms = tube(), bend()
    weights = hstack([weights_of(surface.vertices), csr_array((len(surface.vertices), 3))]).tocsr()
    pose = _estimate(surface, pose_surface(surface, transforms).vertices, weights, parents=[-1, 0, 1, 1, 3, -1])
    assert len(pose.transforms.scale) == 6
    for bone in (3, 4):
        np.testing.assert_array_equal(pose.transforms.rotation[bone], pose.transforms.rotation[1])
        np.testing.assert_array_equal(pose.transforms.translation[bone], pose.transforms.translation[1])
    np.testing.assert_allclose(pose.transforms.rotation[5], pose.common.rotation)
    np.testing.assert_allclose(pose.transforms.translation[5], pose.common.translation)


def test_ancestors_are_numbered_among_bones_that_move_vertices():
    parents = np.array([-1, 0, 1, 2, -1])
    assert next_above(parents, np.array([0, 3])).tolist() == [0, 0, 0, 1, -1]
    assert next_above(parents, np.array([0, 3]), strictly=True).tolist() == [-1, 0, 0, 0, -1]


def test_bone_of_little_weight_follows_its_neighbour():
    surface, transforms = tube(), bend(second=(0, 0, 0))
    weights = weights_of(surface.vertices).toarray()
    weak = np.flatnonzero(surface.vertices[:, 2] > 0.999 * LENGTH)[:2]
    weights[:, 1] += weights[:, 2]
    weights[:, 2] = 0
    weights[weak] = [0, 0.7, 0.3]
    moved = pose_surface(surface, transforms, csr_array(weights)).vertices
    moved[weak[0]] += [0.1, 0.05, 0]
    trust = np.ones(len(moved))
    trust[weak] = 1e-3
    pose = _estimate(surface, moved, csr_array(weights), trust)
    with retune(BONES, coherence=0.0):
        free = _estimate(surface, moved, csr_array(weights), trust)
    assert _angles(pose.transforms, transforms)[2] < 0.2
    assert _angles(free.transforms, transforms)[2] > 0.5


def test_shells_of_one_bone_each_are_fitted_independently():
    surface, transforms = tube(), bend()
    sharp = csr_array(np.eye(3)[np.digitize(surface.vertices[:, 2], [2.0, 4.0])])
    for parents in (PARENTS, None):
        pose = _estimate(surface, pose_surface(surface, transforms, sharp).vertices, sharp, parents=parents)
        assert _angles(pose.transforms, transforms).max() < 1e-3


def test_images_that_slid_along_the_surface_are_fitted_along_normals():
    surface, transforms = tube(), bend()
    target = pose_surface(surface, transforms)
    normals = target.working.vertex_normals[target.working.vertex_of]
    slide = np.array([0.15, 0.0, 0.0])
    images = target.vertices + slide - (normals @ slide)[:, None] * normals  # a map with the same error everywhere
    given = weights_of(surface.vertices), np.ones(len(images)), PARENTS
    start = estimate_pose(surface.vertices, images, *given)

    def slid():
        pose = start
        for _ in range(6):
            pose = refine_pose(pose, surface.vertices, images, normals, *given)
        return np.abs(pose.transforms.translation - transforms.translation).max()

    off = np.abs(start.transforms.translation - transforms.translation).max()
    assert off > 0.1
    assert slid() < 0.3 * off
    with retune(BONES, sliding=1.0):
        assert slid() > 0.5 * off


def test_missing_weights_are_refused():
    surface = tube()
    with pytest.raises(zo.MeshError, match="No vertex with a reliable match"):
        _estimate(surface, surface.vertices, csr_array((len(surface.vertices), 3)))
    with pytest.raises(zo.MeshError, match="No vertex"):
        _estimate(surface, surface.vertices, trust=np.zeros(len(surface.vertices)))


def test_pose_does_not_depend_on_the_unit():
    surface, transforms = tube(), bend()
    moved = pose_surface(surface, transforms).vertices + 0.01 * np.random.default_rng(0).standard_normal((656, 3))
    pose = _estimate(surface, moved)
    again = estimate_pose(
        1000 * surface.vertices, 1000 * moved, weights_of(surface.vertices), np.full(656, 1e-6), PARENTS
    )
    np.testing.assert_allclose(again.transforms.rotation, pose.transforms.rotation, atol=1e-9)
    np.testing.assert_allclose(again.transforms.translation, 1000 * pose.transforms.translation, atol=1e-5)
    assert isinstance(pose.transforms, Similarities)
