# SPDX-License-Identifier: GPL-3.0-or-later
"""Signatures are intrinsic; pseudo-scalars and curvature distinguish outside from inside."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, directions
from scipy.spatial import ConvexHull

from zoomout_core import heat_kernel_map, heat_kernel_signature, wave_kernel_map, wave_kernel_signature
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral.descriptors import mean_curvature, pseudo_scalars
from zoomout_core.spectral.eigenbasis import SpectralBasis, eigenbasis, working_basis
from zoomout_core.spectral.laplacian import mesh_laplacian


def test_signatures_agree_across_poses(resting: Creature, bent: Creature) -> None:
    from creatures import true_vertex

    bases = [working_basis(creature.surface.working, 80) for creature in (resting, bent)]
    image = true_vertex(resting, bent)
    for signature in (wave_kernel_signature, heat_kernel_signature):
        first, second = (np.log(signature(basis, 20)) for basis in bases)
        right = np.abs(first[image] - second).mean()
        wrong = np.abs(first[np.random.default_rng(0).permutation(image)] - second).mean()
        assert right < wrong / 2


@pytest.mark.parametrize("signature", [wave_kernel_signature, heat_kernel_signature])
def test_loose_parts_do_not_change_signatures(signature) -> None:
    # Functions that are constant on each part are uninformative, even if rounding makes their eigenvalues nonzero.
    alone = eigenbasis(creature(600, seed=1).surface, 40)
    part = SpectralBasis(
        np.concatenate([[0, 1e-13, 1e-7], alone.eigenvalues[1:]]),
        np.column_stack([np.ones((600, 3)), alone.eigenvectors[:, 1:]]),
        alone.areas,
        alone.points,
        components=3,
    )
    np.testing.assert_array_equal(signature(part, 10), signature(alone, 10))
    with pytest.raises(ValueError, match="more eigenfunctions than the 3 that are constant"):
        signature(part, 10, k=3)


def test_basis_counts_the_components_of_its_surface() -> None:
    one, other = creature(300, seed=0).surface, creature(200, seed=1).surface
    joined = Surface.joined([one, other.with_vertices(other.vertices * 0.3 + 9)])
    assert eigenbasis(one, 5).components == 1
    basis = eigenbasis(joined, 5)
    assert basis.components == 2
    assert basis.eigenvalues[1] < 1e-6 < basis.eigenvalues[2]


@pytest.mark.parametrize(
    ("signature", "kernels"), [(wave_kernel_signature, wave_kernel_map), (heat_kernel_signature, heat_kernel_map)]
)
def test_landmark_kernels_are_symmetric_and_contain_the_signatures(signature, kernels) -> None:
    basis = eigenbasis(creature(300, seed=0).surface, 30)
    vertices = np.arange(300)
    found = kernels(basis, vertices, 4).reshape(300, 300, 4)  # vertex, landmark, energy or time
    np.testing.assert_allclose(found[vertices, vertices], signature(basis, 4), rtol=1e-9)
    np.testing.assert_allclose(found, found.transpose(1, 0, 2), atol=1e-9)
    np.testing.assert_allclose(kernels(basis, [7, 5], 4), found[:, [7, 5]].reshape(300, 8), atol=1e-12)


def test_descriptors_refuse_invalid_arguments() -> None:
    basis = eigenbasis(creature(300, seed=0).surface, 12)
    for wrong, words in (
        (lambda: wave_kernel_signature(basis, 0), "count is 0: give a whole number"),
        (lambda: heat_kernel_signature(basis, 5, k=13), "has only 12 eigenfunctions: compute more"),
        (lambda: wave_kernel_signature(basis, 5, width=float("nan")), "give a number above zero"),
        (lambda: wave_kernel_signature(basis, 100, width=0.01), "between the eigenvalues: widen"),
        (lambda: wave_kernel_map(basis, [300]), "Landmarks must be vertex numbers from 0 to 299"),
        (lambda: heat_kernel_map(basis, [0.5]), "Landmarks must be vertex numbers from 0 to 299"),
    ):
        with pytest.raises(ValueError, match=words):
            wrong()


def test_pseudo_scalars_change_sign_under_reflection(resting: Creature) -> None:
    mirrored = Surface(resting.surface.vertices * [-1, 1, 1], resting.surface.triangles[:, ::-1])
    values = []
    for surface in (resting.surface, mirrored):
        areas = mesh_laplacian(surface.working.vertices, surface.working.triangles)[1]
        values.append(pseudo_scalars(surface.working, areas, resting.surface.vertices, *np.array([[0], [2]])))
    assert np.abs(values[0]).mean() > 0.1
    np.testing.assert_allclose(values[1], -values[0], atol=1e-9)


def test_pseudo_scalars_of_sphere_coordinates_equal_the_normal() -> None:
    points = directions(4000, seed=2)
    working = Surface(points, ConvexHull(points).simplices).working
    areas = mesh_laplacian(working.vertices, working.triangles)[1]
    # <n, grad x cross grad y> = n_z at any scale, if x and y scale with the mesh.
    found = pseudo_scalars(working, areas, working.vertices, np.array([0, 1, 0]), np.array([1, 2, 0]))
    np.testing.assert_allclose(found[:, 0], points[:, 2], atol=0.05)
    np.testing.assert_allclose(found[:, 1], points[:, 0], atol=0.05)
    np.testing.assert_allclose(found[:, 2], 0, atol=1e-12)


def test_the_mean_curvature_of_a_sphere_is_one_over_its_radius() -> None:
    points = directions(4000, seed=2)
    for simplices in (ConvexHull(points).simplices, ConvexHull(points).simplices[:, ::-1]):
        working = Surface(points, simplices).working
        stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
        curvature = mean_curvature(working, stiffness, areas)
        np.testing.assert_allclose(np.median(curvature), np.sqrt(4 * np.pi), rtol=0.02)
