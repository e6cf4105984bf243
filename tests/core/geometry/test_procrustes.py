# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations and similarities that align point sets: one or many pairs, weighted, of either handedness and any scale."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.procrustes import (
    MANY_MATRICES,
    Moments,
    Similarities,
    nearest_rotations,
    procrustes,
    products,
)

POINTS = np.random.default_rng(0).normal(size=(4, 30, 3)) * [3.0, 2.0, 1.0] + [5.0, 0, 0]


def similarities(sense: int = 1) -> Similarities:
    return Similarities(
        np.array([0.5, 1.0, 2.0, 7.0]),
        Rotation.random(4, random_state=1).as_matrix() * [sense, 1, 1],
        np.arange(12.0).reshape(4, 3),
    )


def assert_same(found: Similarities, truth: Similarities) -> None:
    for name in ("scale", "rotation", "translation"):
        np.testing.assert_allclose(getattr(found, name), getattr(truth, name), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("handedness", ["forced", "free"])
def test_similarities_are_recovered_singly_and_in_batches(sense: int, handedness: str) -> None:
    truth = similarities(sense)
    images = truth(POINTS)
    assert_same(procrustes(POINTS, images, handedness=sense if handedness == "forced" else None), truth)
    for i in range(4):
        one = procrustes(POINTS[i], images[i], handedness=sense if handedness == "forced" else None)
        assert_same(one, Similarities(*(getattr(truth, name)[i] for name in ("scale", "rotation", "translation"))))
        np.testing.assert_allclose(one(POINTS[i]), images[i])
        np.testing.assert_allclose(one.inverse(images[i]), POINTS[i])


def test_given_handedness_is_kept_even_if_the_other_fits_better() -> None:
    images = similarities(-1)(POINTS)
    found = procrustes(POINTS, images)
    np.testing.assert_allclose(np.linalg.det(found.rotation), 1)
    mixed = procrustes(POINTS, images, handedness=np.array([1.0, -1, 1, -1]))
    np.testing.assert_allclose(np.linalg.det(mixed.rotation), [1, -1, 1, -1])


def test_solution_is_a_local_minimum_of_the_residual() -> None:
    random = np.random.default_rng(2)
    points, images, weights = random.normal(size=(20, 3)), random.normal(size=(20, 3)), random.uniform(size=20)
    best = procrustes(points, images, weights)

    def left(motion: Similarities) -> float:
        return float(weights @ ((motion(points) - images) ** 2).sum(axis=1))

    for _ in range(50):
        turn = Rotation.from_rotvec(0.05 * random.normal(size=3)).as_matrix()
        scale = np.asarray(best.scale * np.exp(0.05 * random.normal()))
        shift = best.translation + 0.05 * random.normal(size=3)
        assert left(Similarities(scale, turn @ best.rotation, shift)) > left(best)


def test_points_of_zero_weight_are_ignored() -> None:
    truth = similarities()
    images = truth(POINTS)
    images[:, 20:] += 10
    weights = np.where(np.arange(30) < 20, 0.3, 0.0)
    assert_same(procrustes(POINTS, images, weights), truth)
    assert_same(procrustes(POINTS, images, np.tile(weights, (4, 1))), truth)
    assert np.abs(procrustes(POINTS, images).translation - truth.translation).max() > 1


def test_scales_are_clamped_and_centroids_coincide() -> None:
    images = similarities()(POINTS)
    assert (procrustes(POINTS, images, scales=(1, 1)).scale == 1).all()
    limited = procrustes(POINTS, images, scales=(np.array([0.1, 2.0, 0.1, 0.1]), np.array([9.0, 9.0, 1.5, 9.0])))
    np.testing.assert_allclose(limited.scale, [0.5, 2.0, 1.5, 7.0])
    np.testing.assert_allclose(limited(POINTS).mean(axis=1), images.mean(axis=1))


def test_points_in_the_plane_are_aligned() -> None:
    points = POINTS[..., :2]
    truth = Similarities(np.full(4, 2.0), np.tile([[0.6, 0.8], [0.8, -0.6]], (4, 1, 1)), np.ones((4, 2)))
    assert_same(procrustes(points, truth(points), handedness=None), truth)


def test_moments_from_means_of_products_agree() -> None:
    images = similarities()(POINTS)
    means = np.stack([products(*pair).mean(axis=0) for pair in zip(POINTS, images, strict=True)])
    of_points, of_products = Moments.between(POINTS, images), Moments.of_products(means)
    for name in ("place", "image", "cross", "spread"):
        np.testing.assert_allclose(getattr(of_points, name), getattr(of_products, name), rtol=1e-9)
    assert of_points.handedness == 1
    assert Moments.between(POINTS, POINTS * [1, 1, -1]).handedness == -1


@pytest.mark.parametrize("handed", [1.0, -1.0])
def test_nearest_rotations_have_the_requested_handedness(handed: float) -> None:
    matrices = np.random.default_rng(0).normal(size=(40, 3, 3))
    found = nearest_rotations(matrices, np.full(40, handed))
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.tile(np.eye(3), (40, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found), handed)
    # No other of many rotations is nearer.
    others = nearest_rotations(np.random.default_rng(1).normal(size=(500, 3, 3)), np.full(500, handed))
    best = np.linalg.norm(matrices[:, None] - others, axis=(2, 3)).min(axis=1)
    assert (np.linalg.norm(matrices - found, axis=(1, 2)) <= best + 1e-12).all()


def test_the_nearest_orthogonal_matrix_may_have_either_handedness() -> None:
    matrices = np.random.default_rng(0).normal(size=(40, 4, 4))
    free = nearest_rotations(matrices, None)
    both = [np.linalg.norm(matrices - nearest_rotations(matrices, sense), axis=(1, 2)) for sense in (1, -1)]
    np.testing.assert_allclose(np.linalg.norm(matrices - free, axis=(1, 2)), np.minimum(*both))


@pytest.mark.parametrize(
    "singular", [(1, 0.5, 0.2), (1, 0.1, -0.01), (1, 0.02, -0.0199), (1, 1, -1), (1, 0, 0), (0, 0, 0)]
)
@pytest.mark.parametrize("handed", [1.0, -1.0])
def test_large_batches_give_the_same_rotations_as_small_ones(singular: tuple[float, ...], handed: float) -> None:
    left, right = Rotation.random(2 * MANY_MATRICES, random_state=0).as_matrix().reshape(2, MANY_MATRICES, 3, 3)
    matrices = 1e-3 * (left * np.array(singular)) @ right
    many = nearest_rotations(matrices, handed)
    few = np.concatenate([nearest_rotations(some, handed) for some in np.split(matrices, 2)])
    np.testing.assert_allclose(np.linalg.det(many), handed)
    gained = np.einsum("nij,nij->n", many - few, matrices)  # ambiguous matrices have several nearest rotations
    np.testing.assert_allclose(gained, 0, atol=1e-12)
    if singular[1] > abs(singular[2]):
        np.testing.assert_allclose(many, few, atol=1e-9)
