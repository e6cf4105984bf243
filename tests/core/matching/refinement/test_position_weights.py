# SPDX-License-Identifier: GPL-3.0-or-later
"""Weight of spatial positions relative to eigenfunctions, and normalisation of blended rotations."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.spatial.transform import Rotation

from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.refinement.local_rigid_alignment import (
    Alignment,
    align,
    beside_places,
)
from zoomout_core.matching.refinement.refine import REFINEMENT, _nearest_near_samples, _weight_factor, refine


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    return analyse(creature(500).surface.working.part(0)[0], 100, 200, 0)


def weight_factor(shape: ShapeAnalysis, off_in_space: float, off_along: float) -> float:
    """Weight factor of a map with errors of `off_in_space` in space and about `off_along` along the surface."""
    samples = shape.sampled.samples
    vertices = shape.mesh.vertices
    noise = np.random.default_rng(0).normal(scale=off_along, size=(len(samples), 3))
    vertex = np.linalg.norm((vertices[samples] + noise)[:, None] - vertices, axis=2).argmin(axis=1)
    aligned = Alignment(vertices[vertex] + [off_in_space, 0, 0], shape.mesh.vertex_normals[samples])
    return _weight_factor(vertex, aligned, shape, shape, 30)


def test_weight_of_space_grows_with_its_accuracy_within_limits(shape: ShapeAnalysis) -> None:
    factors = [weight_factor(shape, off, 0.1) for off in (0.001, 0.03, 0.06, 1.0)]
    assert factors == sorted(factors, reverse=True)
    assert factors[0] > 2
    assert factors[-1] < 0.5
    assert factors[-1] > 0.05
    assert factors[0] < 20
    assert factors[1] > factors[2]
    assert weight_factor(shape, 0.03, 0.2) > weight_factor(shape, 0.03, 0.02)


def test_weight_grows_with_the_fourth_power_of_the_error_ratio(shape: ShapeAnalysis) -> None:
    least, most = weight_factor(shape, 1.0, 0.1), weight_factor(shape, 0.0, 0.1)
    factors = [weight_factor(shape, off, 0.1) for off in np.geomspace(0.01, 0.2, 60)]
    between = [factor for factor in factors if 1.01 * least < factor < 0.99 * most]
    step = (0.2 / 0.01) ** (1 / 59)
    assert len(between) > 5
    np.testing.assert_allclose(np.divide(between[:-1], between[1:]), step**4)


def test_exact_map_in_space_has_the_maximum_weight(shape: ShapeAnalysis) -> None:
    with np.errstate(divide="raise", invalid="raise"):
        assert weight_factor(shape, 0.0, 0.1) == REFINEMENT.max_factor


def test_places_and_eigenfunctions_have_the_same_scale(shape: ShapeAnalysis) -> None:
    # Neighbours on the surface are equally far apart in both.
    a, b = shape.mesh.triangles[:, 0], shape.mesh.triangles[:, 1]
    aligned = Alignment(shape.mesh.vertices, 0 * shape.mesh.vertex_normals)
    rows = shape.basis.eigenvectors[:, :30]
    both, _ = beside_places(rows, rows, aligned, shape, 30, 1.0)
    step = both[a] - both[b]
    ratio = np.linalg.norm(step[:, 30:33], axis=1) / np.linalg.norm(step[:, :30], axis=1)
    assert 0.6 < np.median(ratio) < 1.6
    quarter, _ = beside_places(rows, rows, aligned, shape, 30, 0.25)
    np.testing.assert_allclose(quarter[:, 30:33], both[:, 30:33] / 2)


def test_normals_distinguish_the_two_sides_of_a_limb(shape: ShapeAnalysis) -> None:
    rows = np.zeros((len(shape.mesh.vertices), 1))
    normals = shape.mesh.vertex_normals
    aligned = Alignment(shape.mesh.vertices, -normals)
    queries, embedded = beside_places(rows, rows, aligned, shape, 30, 1.0)
    other_side = np.linalg.norm(queries[:, None] - embedded, axis=2).argmin(axis=1)
    assert np.median(np.einsum("nx,nx->n", normals, normals[other_side])) < -0.3
    off = np.linalg.norm(shape.mesh.vertices[other_side] - shape.mesh.vertices, axis=1)
    assert np.median(off) < 0.3  # but not far away


def test_nearest_vertex_is_found_near_the_nearest_sample(shape: ShapeAnalysis) -> None:
    queries = shape.mesh.vertices + np.random.default_rng(0).normal(scale=0.01, size=shape.mesh.vertices.shape)
    exact = np.linalg.norm(queries[:, None] - shape.mesh.vertices, axis=2).argmin(axis=1)
    assert (_nearest_near_samples(queries, shape.mesh.vertices, shape) == exact).mean() > 0.99


def test_alignment_smooths_noise_of_images_away(shape: ShapeAnalysis) -> None:
    noise = np.random.default_rng(0).normal(scale=0.05, size=shape.mesh.vertices.shape)
    images = shape.basis.coefficients(shape.mesh.vertices + noise)
    off = [
        np.linalg.norm(align(images, shape, width, False).positions - shape.mesh.vertices, axis=1).mean()
        for width in (0.0, 0.08)
    ]
    assert off[1] < 0.8 * off[0]


def test_aligning_few_vertices_agrees_with_aligning_all(shape: ShapeAnalysis) -> None:
    images = shape.basis.coefficients(shape.mesh.vertices @ Rotation.from_rotvec([0, 0, 1.0]).as_matrix().T)
    some = np.array([3, 77, 400])
    whole, few = align(images, shape, 0.08, False), align(images, shape, 0.08, False, some)
    np.testing.assert_allclose(few.positions, whole.positions[some])
    np.testing.assert_allclose(few.normals, whole.normals[some])


def test_refined_map_is_finer_and_limited_by_the_mesh_resolution() -> None:
    source, target = creature(600, seed=0), creature(560, seed=1, bend=0.4)
    shapes = [analyse(one.surface.working.part(0)[0], 100, 300, 0) for one in (source, target)]
    C = functional_map_of(true_vertex(source, target), shapes[0].basis, shapes[1].basis, 10, 10)
    rough = vertex_map_of(C, shapes[0].basis, shapes[1].basis)
    dense, functional_map = refine(*shapes, C, None, False, 100, 20)

    def missed(images: np.ndarray) -> float:
        images = images / np.linalg.norm(images, axis=1, keepdims=True)
        return float(np.linalg.norm(images - target.directions, axis=1).mean())

    assert missed(dense.interpolate(source.directions)) < 0.5 * missed(source.directions[rough])
    assert 30 <= len(functional_map) < 60
