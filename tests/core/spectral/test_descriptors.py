"""Signatures are intrinsic; pseudo-scalars and curvature know the outside from the inside."""

from __future__ import annotations

import numpy as np
from creatures import Creature, directions
from scipy.spatial import ConvexHull

from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.stepping import drain
from zoomout_core.spectral.descriptors import (
    heat_kernel_signature,
    mean_curvature,
    pseudo_scalars,
    wave_kernel_signature,
)
from zoomout_core.spectral.eigenbasis import working_basis_steps
from zoomout_core.spectral.laplacian import mesh_laplacian


def test_signatures_of_the_same_place_agree_in_another_pose(resting: Creature, bent: Creature) -> None:
    from creatures import true_vertex

    bases = [drain(working_basis_steps(creature.surface.working, 80)) for creature in (resting, bent)]
    image = true_vertex(resting, bent)
    for signature in (wave_kernel_signature, heat_kernel_signature):
        first, second = (np.log(signature(basis, 20)) for basis in bases)
        right = np.abs(first[image] - second).mean()
        wrong = np.abs(first[np.random.default_rng(0).permutation(image)] - second).mean()
        assert right < wrong / 2


def test_pseudo_scalars_turn_their_sign_in_the_mirror(resting: Creature) -> None:
    mirrored = Surface(resting.surface.vertices * [-1, 1, 1], resting.surface.triangles[:, ::-1])
    f, g = resting.surface.vertices[:, [0]], resting.surface.vertices[:, [2]]
    values = []
    for surface in (resting.surface, mirrored):
        areas = mesh_laplacian(surface.working.vertices, surface.working.triangles)[1]
        values.append(pseudo_scalars(surface.working, areas, f, g))
    assert np.abs(values[0]).mean() > 0.1
    np.testing.assert_allclose(values[1], -values[0], atol=1e-9)


def test_pseudo_scalars_of_coordinates_on_a_sphere_are_the_normal() -> None:
    points = directions(4000, seed=2)
    working = Surface(points, ConvexHull(points).simplices).working
    areas = mesh_laplacian(working.vertices, working.triangles)[1]
    # <n, grad x cross grad y> = n_z, whatever the scale of the mesh when x and y scale with it.
    found = pseudo_scalars(working, areas, working.vertices[:, [0]], working.vertices[:, [1]])[:, 0]
    np.testing.assert_allclose(found, points[:, 2], atol=0.05)


def test_the_mean_curvature_of_a_sphere_is_one_over_its_radius() -> None:
    points = directions(4000, seed=2)
    for simplices in (ConvexHull(points).simplices, ConvexHull(points).simplices[:, ::-1]):
        working = Surface(points, simplices).working
        stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
        curvature = mean_curvature(working, stiffness, areas)
        np.testing.assert_allclose(np.median(curvature), np.sqrt(4 * np.pi), rtol=0.02)
