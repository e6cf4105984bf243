# SPDX-License-Identifier: GPL-3.0-or-later
"""Descriptor operators: products with descriptors, and derivatives along their level lines."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, directions
from scipy.spatial import ConvexHull

from zoomout_core import MeshError, PointCloud, Surface, eigenbasis, multiplication_operators, orientation_operators
from zoomout_core.spectral.eigenbasis import SpectralBasis


@pytest.fixture(scope="module")
def made() -> Creature:
    return creature(300, seed=0)


@pytest.fixture(scope="module")
def basis(made: Creature) -> SpectralBasis:
    return eigenbasis(made.surface, 30)


def test_multiplication_operators_multiply(made, basis) -> None:
    f = made.surface.vertices[:, :2]
    operators = multiplication_operators(basis, f, 12)
    assert operators.shape == (2, 12, 12)
    for operator, each in zip(operators, f.T, strict=True):
        products = basis.coefficients(each[:, None] * basis.eigenvectors[:, :12])[:12]
        np.testing.assert_allclose(operator, products, atol=1e-12)


def test_orientation_operator_on_a_sphere_rotates_about_an_axis() -> None:
    # <n x grad z, grad x> is y, and <n x grad z, grad y> is -x, up to the sign of the axis.
    points = directions(1500, seed=0)
    sphere = Surface(points, ConvexHull(points).simplices)
    basis = eigenbasis(sphere, 4)
    operator = orientation_operators(sphere, basis, points[:, 2], 4)[0]
    x, y, z = basis.coefficients(points).T
    # Unit area divides lengths by sqrt(4 pi), and the operator takes two derivatives.
    np.testing.assert_allclose(operator @ x / (4 * np.pi), y, atol=0.02)
    np.testing.assert_allclose(operator @ y / (4 * np.pi), -x, atol=0.02)
    np.testing.assert_allclose(operator @ z, 0, atol=0.02 * 4 * np.pi)


def test_orientation_operators_are_antisymmetric_and_flip_when_mirrored(made, basis) -> None:
    f = made.surface.vertices[:, [2]] ** 2
    operators = orientation_operators(made.surface, basis, f, 20)
    assert np.abs(operators).max() > 1
    np.testing.assert_allclose(operators, -operators.transpose(0, 2, 1), atol=1e-9)
    triangles = made.surface.triangles[:, ::-1]
    mirrored = Surface(made.surface.vertices * [-1, 1, 1], triangles)
    np.testing.assert_allclose(orientation_operators(mirrored, basis, f, 20), -operators, atol=1e-9)
    # The winding belongs to the mesh, not to the surface.
    inside_out = Surface(made.surface.vertices, triangles)
    np.testing.assert_allclose(orientation_operators(inside_out, basis, f, 20), operators, atol=1e-9)


def test_orientation_operators_of_a_cloud_equal_those_of_its_surface(made) -> None:
    cloud = PointCloud(creature(1500, seed=0).surface.vertices)
    basis = eigenbasis(cloud, 10)
    f = cloud.points[:, [2]]
    found = orientation_operators(cloud, basis, f, 10)
    np.testing.assert_array_equal(found, orientation_operators(cloud.surface, basis, f, 10))
    assert np.abs(found).max() > 0.1


def test_operators_refuse_invalid_arguments(made, basis) -> None:
    surface, f = made.surface, made.surface.vertices
    hole = f.copy()
    hole[3, 1] = np.nan
    for wrong, words in (
        (lambda: multiplication_operators(basis, f[:-1], 5), r"each of the basis's 300 vertices, not the shape \(299"),
        (lambda: multiplication_operators(basis, f, 31), "k is 31, but the basis has only 30"),
        (lambda: multiplication_operators(basis, f, 2.5), "k is 2.5: give a whole number"),
        (lambda: multiplication_operators(basis, f[:, :0], 5), "are empty: give at least one"),
        (lambda: multiplication_operators(basis, hole, 5), "must be finite numbers"),
        (lambda: multiplication_operators(basis, [["a"]], 5), "must be an array of numbers"),
        (lambda: orientation_operators(creature(200).surface, basis, f, 5), "300 vertices, but the surface has 200"),
        (lambda: orientation_operators(surface, basis, hole, 5), "must be finite numbers"),
        (lambda: orientation_operators(surface, basis, f, 31), "k is 31, but the basis has only 30"),
    ):
        with pytest.raises(ValueError, match=words):
            wrong()
    with pytest.raises(MeshError, match="No surface passes through the points"):
        orientation_operators(PointCloud(np.ones((20, 3))), basis, f, 5)
