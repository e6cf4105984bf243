# SPDX-License-Identifier: GPL-3.0-or-later
"""The residual of local similarities is zero for similarities, and large where a map reflects or scatters."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature
from scipy.spatial.transform import Rotation

from zoomout_core.geometry import similarity_residual as module
from zoomout_core.geometry.similarity_residual import similarity_residual


@pytest.fixture(scope="module")
def shape() -> Creature:
    return creature(600, seed=0)


def residual(shape: Creature, images: np.ndarray, rings: int = 3) -> np.ndarray:
    return similarity_residual(shape.surface.vertices, shape.surface.triangles, images, rings)


def apply_similarity(points: np.ndarray) -> np.ndarray:
    return 7.0 * points @ Rotation.random(random_state=1).as_matrix().T + [100.0, 0.0, -3.0]


@pytest.mark.parametrize("rings", [1, 3])
def test_similarity_has_no_residual(shape: Creature, rings: int) -> None:
    assert residual(shape, apply_similarity(shape.surface.vertices), rings).max() < 1e-8


def test_residual_does_not_depend_on_placement_or_scale(shape: Creature) -> None:
    images = shape.surface.vertices + 0.02 * np.random.default_rng(0).normal(size=shape.surface.vertices.shape)
    first = residual(shape, images)
    np.testing.assert_allclose(residual(shape, apply_similarity(images)), first, atol=1e-8)
    turned = similarity_residual(apply_similarity(shape.surface.vertices), shape.surface.triangles, images, 3)
    np.testing.assert_allclose(turned, first, atol=1e-8)


def test_residual_grows_from_bending_to_reflection_to_noise(shape: Creature) -> None:
    vertices = shape.surface.vertices
    bent = residual(shape, creature(600, seed=0, bend=0.3).surface.vertices).mean()
    reflected = residual(shape, vertices * [-1, 1, 1]).mean()
    scattered = residual(shape, np.random.default_rng(0).permutation(vertices)).mean()
    assert 0 < 5 * bent < reflected < scattered < 1
    assert residual(shape, np.zeros_like(vertices)).min() == 1


def test_residual_equals_that_of_weighted_local_fits(shape: Creature) -> None:
    vertices, edges = shape.surface.vertices, shape.surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    images = vertices + 0.05 * np.random.default_rng(0).normal(size=vertices.shape)
    found = residual(shape, images, 1)
    for vertex in (0, 17, 250):
        near = np.unique(edges[edges[:, 0] == vertex, 1])
        x, y = vertices[near] - vertices[vertex], images[near] - images[vertex]
        weights = 1 / (x**2).sum(axis=1)
        rotation, root = Rotation.align_vectors(y, x, weights=weights)
        turned = rotation.apply(x)
        scale = weights @ (turned * y).sum(axis=1) / len(near)
        left = weights @ ((y - scale * turned) ** 2).sum(axis=1)
        assert found[vertex] == pytest.approx(left / (weights @ (y**2).sum(axis=1)), rel=1e-6)
        assert root > 0


def test_block_size_does_not_change_results(shape: Creature, monkeypatch: pytest.MonkeyPatch) -> None:
    images = shape.surface.vertices**2
    whole = residual(shape, images)
    monkeypatch.setattr(module, "BLOCK", 70)
    np.testing.assert_array_equal(residual(shape, images), whole)


def test_unused_vertices_and_duplicate_positions_have_a_residual(shape: Creature) -> None:
    vertices = np.vstack([shape.surface.vertices, [[9.0, 9, 9]]])
    vertices[shape.surface.triangles[0]] = vertices[shape.surface.triangles[0, 0]]
    found = similarity_residual(vertices, shape.surface.triangles, vertices, 3)
    assert np.isfinite(found).all()
    assert found[-1] == 1
    assert found[:-1].max() < 1e-6
