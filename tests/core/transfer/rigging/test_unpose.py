# SPDX-License-Identifier: GPL-3.0-or-later
"""Unposing a surface is exact where skinning determines it, and smooth elsewhere."""

import numpy as np
from bent_tube import bend, pose_surface, tube, weights_of
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.mesh.affine_maps import transform_points
from zoomout_core.transfer.rigging.skinning import skinning_matrices
from zoomout_core.transfer.rigging.unpose import UNPOSE, unpose
from zoomout_core.tuning import retune

SOFT = ((40, 0, 20), (30, 10, 0))


def _matrices(surface, transforms, weights=None):
    return skinning_matrices(transforms, weights_of(surface.vertices) if weights is None else weights)


def test_skinning_is_undone_exactly():
    surface, transforms = tube(), bend(*SOFT, scale=2.0)
    target, matrices = pose_surface(surface, transforms), _matrices(tube(), transforms)
    rest = unpose(target, matrices, 2.0, np.ones(len(surface.vertices)))
    np.testing.assert_allclose(rest.positions, surface.vertices, atol=1e-9)
    assert rest.smoothed == 0
    offsets = np.random.default_rng(0).standard_normal(surface.vertices.shape)
    turned = np.einsum("nxy,ny->nx", matrices[:, :, :3], offsets)
    np.testing.assert_allclose(np.einsum("nxy,ny->nx", rest.linear, turned), offsets, atol=1e-9)


def test_the_targets_own_detail_is_kept():
    surface, transforms = tube(), bend(*SOFT)
    detailed = surface.with_vertices(surface.vertices * [1.2, 0.9, 1] + 0.02 * np.sin(9 * surface.vertices))
    weights = weights_of(surface.vertices)
    rest = unpose(pose_surface(detailed, transforms, weights), _matrices(surface, transforms), 1.0, np.ones(656))
    np.testing.assert_allclose(rest.positions, detailed.vertices, atol=1e-9)


def _off(rest, surface, where):
    return np.linalg.norm(rest.positions - surface.vertices, axis=1)[where].max()


def test_surface_keeps_its_shape_where_weights_tear():
    surface, transforms = tube(), bend(*SOFT)
    weights = weights_of(surface.vertices).toarray()
    wrong = np.flatnonzero(np.abs(surface.vertices[:, 2] - 1.0) < 0.2)[:6]
    weights[wrong] = [0, 0, 1]
    target = pose_surface(surface, transforms)
    rest = unpose(target, _matrices(surface, transforms, csr_array(weights)), 1.0, np.ones(656))
    assert 6 <= rest.smoothed < 60
    assert _off(rest, surface, slice(None)) < 0.1
    with retune(UNPOSE, max_strain=1000.0):
        torn = unpose(target, _matrices(surface, transforms, csr_array(weights)), 1.0, np.ones(656))
    assert _off(torn, surface, slice(None)) > 1


def test_surface_keeps_its_shape_where_the_map_is_doubtful():
    surface, transforms = tube(), bend(*SOFT)
    target = pose_surface(surface, transforms)
    doubtful = surface.vertices[:, 2] < 0.7
    weights = weights_of(surface.vertices).toarray()
    weights[doubtful] = [0.3, 0.7, 0]
    confidence = np.where(doubtful, 0.0, 1.0)
    rest = unpose(target, _matrices(surface, transforms, csr_array(weights)), 1.0, confidence)
    assert doubtful.sum() <= rest.smoothed < 1.5 * doubtful.sum()
    assert _off(rest, surface, ~doubtful) < 0.05
    assert _off(rest, surface, doubtful) < 0.35
    sure = unpose(target, _matrices(surface, transforms, csr_array(weights)), 1.0, np.ones(656))
    assert _off(sure, surface, doubtful) > 0.7


def test_a_collapsed_blend_is_not_inverted():
    surface, transforms = tube(), bend((0, 0, 178), (0, 0, 0))
    target = pose_surface(surface, transforms)
    rest = unpose(target, _matrices(surface, transforms), 1.0, np.ones(656))
    assert rest.smoothed
    assert _off(rest, surface, slice(None)) < 0.6
    with retune(UNPOSE, min_extent=0.0, max_strain=1000.0):
        blown = unpose(target, _matrices(surface, transforms) + 1e-3, 1.0, np.ones(656))
    assert np.abs(np.linalg.det(blown.linear)).max() > 10 * np.abs(np.linalg.det(rest.linear)).max()


def test_loose_and_split_vertices_stay_with_their_surroundings():
    whole, transforms = tube(), bend(*SOFT)
    corners = whole.vertices[whole.corner_vertex]  # faces have separate corners, as exporters split them
    faces = np.split(np.arange(len(corners)), whole.face_start[1:-1])
    split = zo.Surface(np.concatenate([corners, [[0.1, 0.1, 1.0]]]), faces)
    weights = weights_of(split.vertices)
    confidence = np.where(split.vertices[:, 2] < 0.7, 0.0, 1.0)
    target = pose_surface(split, transforms)
    rest = unpose(target, skinning_matrices(transforms, weights), 1.0, confidence)
    np.testing.assert_allclose(rest.positions[-1], [0.1, 0.1, 1.0], atol=1e-9)
    of_vertex = np.zeros((len(whole.vertices), 3))
    of_vertex[whole.corner_vertex] = rest.positions[:-1]
    np.testing.assert_allclose(of_vertex[whole.corner_vertex], rest.positions[:-1], atol=1e-9)


def test_vertex_without_weights_follows_its_surroundings():
    surface, transforms = tube(), bend(*SOFT)
    weights = weights_of(surface.vertices).toarray()
    weights[100] = 0
    matrices = skinning_matrices(transforms, csr_array(weights))
    rest = unpose(pose_surface(surface, transforms), matrices, 1.0, np.ones(656))
    assert _off(rest, surface, 100) < 0.1
    assert np.abs(transform_points(matrices, rest.positions)[100]).max() == 0
