# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts around a body rotate, mirror and scale with it, within limits."""

from __future__ import annotations

import numpy as np
import pytest
from bent_tube import bend, pose_surface, tube
from creatures import creature
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.procrustes import Moments, products
from zoomout_core.matching.components.similarity_field import SimilarityField, affine_maps, transform_points
from zoomout_core.spectral.eigenbasis import SpectralBasis, eigenbasis

MADE = creature(500)
TURN = Rotation.from_rotvec([0.4, -0.2, 1.0]).as_matrix()


@pytest.fixture(scope="module")
def basis() -> SpectralBasis:
    return eigenbasis(MADE.surface, 80)


def patches(images: np.ndarray, places: np.ndarray) -> Moments:
    """Moments of patches (m, n, 3) and their images."""
    return Moments.of_products(np.stack([products(p, i).mean(axis=0) for p, i in zip(places, images, strict=True)]))


PLACES = np.random.default_rng(0).standard_normal((9, 50, 3)) * 0.1


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_similarity_of_patches_is_found_exactly(sense: float) -> None:
    linear = 1.3 * TURN * [sense, 1, 1]
    moments = patches(PLACES @ linear.T + [1, 2, 3], PLACES)
    assert moments.handedness == sense
    np.testing.assert_allclose(moments.scale(sense), 1.3)
    points, normals = np.ones((9, 3)), np.tile([0.0, 0, 1], (9, 1))
    carried, turned = transform_points(affine_maps(moments, sense), points, normals)
    np.testing.assert_allclose(carried, points @ linear.T + [1, 2, 3])
    np.testing.assert_allclose(turned, normals @ (TURN * [sense, 1, 1]).T)


def test_size_of_a_squeezed_patch_is_clamped() -> None:
    factors = np.ones(9)
    factors[0], factors[1] = 0.01, 50
    moments = patches(PLACES * factors[:, None, None], PLACES)
    affine = affine_maps(moments, 1.0)
    sizes = np.cbrt(np.linalg.det(affine[:, :9].reshape(-1, 3, 3)))
    np.testing.assert_allclose(sizes[2:], 1, rtol=1e-6)
    assert 0.3 < sizes[0] < 0.7
    assert 1.5 < sizes[1] < 3


def test_flat_patches_have_the_handedness_of_the_others() -> None:
    flat = PLACES * np.where(np.arange(9) < 7, [[1], [1], [0.0]], [[1], [1], [1.0]]).T[:, None]
    for sense in (1.0, -1.0):
        assert patches(flat @ (TURN * [1, 1, sense]).T, flat).handedness == sense


@pytest.mark.parametrize("off", [0.0, 0.05, 0.3])
def test_points_follow_a_similarity_of_the_whole_body(basis: SpectralBasis, off: float) -> None:
    mesh = MADE.surface.working
    linear = 1.2 * TURN
    motion = SimilarityField(mesh.vertices, mesh.vertices @ linear.T + 1, np.ones(500), basis)
    points = mesh.vertices[::20] + off * mesh.vertex_normals[::20]
    carried, turned, trust = motion.transform(points, mesh.vertex_normals[::20])
    np.testing.assert_allclose(carried, points @ linear.T + 1, atol=1e-6)
    np.testing.assert_allclose(turned, mesh.vertex_normals[::20] @ TURN.T, atol=1e-6)
    np.testing.assert_allclose(trust, 1)
    assert motion.handedness == 1


def test_trust_is_taken_from_the_body_nearby(basis: SpectralBasis) -> None:
    mesh = MADE.surface.working
    trust = (MADE.directions[:, 2] > 0).astype(float)
    motion = SimilarityField(mesh.vertices, mesh.vertices, trust, basis)
    above, below = MADE.directions[:, 2] > 0.8, MADE.directions[:, 2] < -0.8
    assert motion.transform(mesh.vertices[above], mesh.vertex_normals[above])[2].min() > 0.9
    assert motion.transform(mesh.vertices[below], mesh.vertex_normals[below])[2].max() < 0.1


def test_square_roots_of_weights_fall_linearly_with_distance(basis: SpectralBasis) -> None:
    mesh = MADE.surface.working
    point = mesh.vertices[40:41] + 0.01
    distance = np.linalg.norm(mesh.vertices - point, axis=1)
    near = np.argsort(distance)[[0, 2, 5]]
    alone = [SimilarityField(mesh.vertices, mesh.vertices, 1.0 * (np.arange(500) == i), basis) for i in near]
    root = np.sqrt([float(motion.transform(point, point)[2][0]) for motion in alone])
    fallen = -np.diff(root) / np.diff(distance[near])
    assert fallen[0] == pytest.approx(fallen[1], rel=1e-6)
    assert fallen[0] > 0


def test_near_points_follow_a_smaller_region_than_far_ones(basis: SpectralBasis) -> None:
    # Only one tip of the body rotates.
    mesh = MADE.surface.working
    tip = MADE.directions[:, 1] > 0.95
    images = mesh.vertices.copy()
    centre = images[tip].mean(axis=0)
    images[tip] = (images[tip] - centre) @ Rotation.from_rotvec([0, 1.5, 0]).as_matrix().T + centre
    motion = SimilarityField(mesh.vertices, images, np.ones(500), basis)
    at = np.repeat(centre[None] + [[0, 0.02, 0]], 2, axis=0)
    at[1] += [0, 0.4, 0]
    across = np.tile([1.0, 0, 0], (2, 1))
    _, turned, _ = motion.transform(at, across)
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", turned, across), -1, 1))
    assert angle[0] > 2 * angle[1]


def test_unbending_a_body_does_not_change_its_scale() -> None:
    straight = tube()
    bent = pose_surface(straight, bend((90, 0, 0), (90, 0, 0)))
    motion = SimilarityField(bent.vertices, straight.vertices, np.ones(len(bent.vertices)), eigenbasis(bent, 60))
    assert motion.scale == pytest.approx(1, abs=0.01)
