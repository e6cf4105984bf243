# SPDX-License-Identifier: GPL-3.0-or-later
"""Functional maps fit descriptors, and each term of the energy has its intended effect."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, mirrored_vertex

import zoomout_core as zo
from zoomout_core.maps import descriptor_fit
from zoomout_core.maps.functional_map import eigenvalue_mask, functional_map_of, resolvent_mask
from zoomout_core.spectral.eigenbasis import SpectralBasis


def test_resolvent_mask_is_squared_distance_of_resolvents() -> None:
    of_source, of_target = np.array([0.0, 3, 7, 20]), np.array([0.0, 4, 8, 15, 16])
    x_source, x_target = (np.sqrt(values / 20) for values in (of_source, of_target))
    apart = np.abs(1 / (x_target[:, None] - 1j) - 1 / (x_source - 1j)) ** 2
    np.testing.assert_allclose(
        resolvent_mask(of_source, of_target), apart / apart.mean(axis=1, keepdims=True), atol=1e-12
    )
    np.testing.assert_allclose(
        resolvent_mask(of_target, of_source), apart.T / apart.T.mean(axis=1, keepdims=True), atol=1e-12
    )


def test_eigenvalue_mask_is_squared_difference() -> None:
    of_source, of_target = np.array([0.0, 3, 7]), np.array([0.0, 4])
    apart = np.array([[0.0, 9, 49], [16, 1, 9]])
    np.testing.assert_allclose(eigenvalue_mask(of_source, of_target), apart / apart.mean(axis=1, keepdims=True))


@pytest.fixture(scope="module")
def source() -> Creature:
    return creature(1000, seed=0)


@pytest.fixture(scope="module")
def copy(source: Creature) -> tuple[zo.Surface, np.ndarray]:
    """A permuted, rotated and moved copy of the source, and the original vertex of each of its vertices."""
    random = np.random.default_rng(3)
    order = random.permutation(len(source.surface.vertices))
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    vertices = (source.surface.vertices @ rotation * 37 + [1, 2, 3])[order]
    return zo.Surface(vertices, np.argsort(order)[source.surface.triangles]), order


@pytest.fixture(scope="module")
def bases(source: Creature, copy) -> tuple[SpectralBasis, SpectralBasis]:
    return zo.eigenbasis(source.surface, 60), zo.eigenbasis(copy[0], 60)


@pytest.fixture(scope="module")
def signatures(bases) -> tuple[np.ndarray, np.ndarray]:
    return zo.wave_kernel_signature(bases[0], 30), zo.wave_kernel_signature(bases[1], 30)


def operators_of(source, copy, bases, signatures, k: int) -> tuple[np.ndarray, np.ndarray]:
    return (
        zo.orientation_operators(source.surface, bases[0], signatures[0], k),
        zo.orientation_operators(copy[0], bases[1], signatures[1], k),
    )


def energy_of(F, G, left, right, mask):
    """The energy of a map C, computed directly by its formula."""

    def energy(C: np.ndarray) -> float:
        commuting = sum(((L @ C - C @ R) ** 2).sum() for L, R in zip(left, right, strict=True))
        return float(((C @ F - G) ** 2).sum() + commuting + (mask * C**2).sum()) / 2

    return energy


@pytest.mark.parametrize("part", ["all", "descriptors", "operators", "mask"])
def test_gradient_and_curvature_are_the_derivatives_of_the_energy(part: str) -> None:
    random = np.random.default_rng(0)
    shapes = {"F": (4, 6), "G": (3, 6), "left": (5, 3, 3), "right": (5, 4, 4), "mask": (3, 4)}
    kinds = {"descriptors": ("F", "G"), "operators": ("left", "right"), "mask": ("mask",)}
    used = kinds.get(part, tuple(shapes))
    terms = [random.standard_normal(shape) ** 2 * (name in used) for name, shape in shapes.items()]
    energy, fit = energy_of(*terms), descriptor_fit._Energy(*terms)
    C, step = random.standard_normal((3, 4)), 1e-4
    units = (step * np.eye(12)).reshape(12, 3, 4)
    found = [(energy(C + unit) - energy(C - unit)) / (2 * step) for unit in units]
    np.testing.assert_allclose(fit.gradient(C), np.reshape(found, (3, 4)), rtol=1e-6, atol=1e-6)
    matrix = fit.curvature_matrix().reshape(12, 12)
    np.testing.assert_allclose(matrix @ C.ravel(), fit.curvature(C).ravel(), rtol=1e-9)
    np.testing.assert_allclose(np.diag(matrix).reshape(3, 4), fit.diagonal_curvature(), rtol=1e-9)
    np.testing.assert_allclose(fit.compress().gradient(C), fit.gradient(C), rtol=1e-9)
    # Average over the signs of all functions but the constant one.
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    mean = np.mean([energy(np.eye(3, 4) * [1, *sign, 0]) for sign in signs])
    np.testing.assert_allclose(fit.mean_value(), mean, rtol=1e-9)


@pytest.mark.parametrize("mask", ["eigenvalues", "resolvent"])
def test_fit_minimizes_the_energy_with_either_solver(bases, signatures, mask, monkeypatch) -> None:
    k_source, k_target, a, b, c = 9, 11, 0.3, 0.7, 0.2
    F, G = (each / np.sqrt(basis.areas @ each**2) for basis, each in zip(bases, signatures, strict=True))
    Y, X = zo.multiplication_operators(bases[0], F, k_source), zo.multiplication_operators(bases[1], G, k_target)
    size = np.sqrt(((X**2).sum(axis=(1, 2)) + (Y**2).sum(axis=(1, 2))) / 2)[:, None, None]
    masks = {"eigenvalues": eigenvalue_mask, "resolvent": resolvent_mask}[mask]
    energy = energy_of(
        np.sqrt(a / 30) * bases[0].coefficients(F)[:k_source],
        np.sqrt(a / 30) * bases[1].coefficients(G)[:k_target],
        np.sqrt(b / 30) * X / size,
        np.sqrt(b / 30) * Y / size,
        c * masks(bases[0].eigenvalues[:k_source], bases[1].eigenvalues[:k_target]),
    )
    options = {"descriptor_weight": a, "multiplication_weight": b, "laplacian_weight": c, "mask": mask}
    C = zo.fit_functional_map(*bases, *signatures, (k_source, k_target), **options)
    assert C.shape == (k_target, k_source)
    np.testing.assert_allclose(C[:, 0], np.eye(k_target)[0], atol=1e-12)
    for change in 1e-3 * np.eye(k_target * k_source).reshape(-1, k_target, k_source):
        if not change[:, 0].any():
            assert energy(C + change) > energy(C) < energy(C - change)
    monkeypatch.setattr(descriptor_fit, "DENSE", 0)
    np.testing.assert_allclose(
        zo.fit_functional_map(*bases, *signatures, (k_source, k_target), **options), C, atol=1e-5
    )


def test_eigenvector_signs_do_not_change_the_fit(source, copy, bases, signatures) -> None:
    signs = np.random.default_rng(1).choice([-1.0, 1.0], size=60)
    signs[0] = -1
    turned = SpectralBasis(bases[0].eigenvalues, bases[0].eigenvectors * signs, bases[0].areas, bases[0].points)
    maps = [
        zo.fit_functional_map(
            first,
            bases[1],
            *signatures,
            10,
            orientation_operators=operators_of(source, copy, (first, bases[1]), signatures, 10),
        )
        for first in (bases[0], turned)
    ]
    np.testing.assert_allclose(maps[0] * signs[:10], maps[1], atol=1e-7)


def test_constant_function_of_disconnected_surface_maps_to_itself(source) -> None:
    surface = source.surface
    joined = zo.Surface.joined([surface, surface.with_vertices(surface.vertices * 0.5 + 9)])
    basis = zo.eigenbasis(joined, 12)
    f = zo.wave_kernel_signature(basis, 10)
    C = zo.fit_functional_map(basis, basis, f, f, 12)
    constant = basis.coefficients(np.ones((len(f), 1)))
    np.testing.assert_allclose(C @ constant, constant, atol=1e-9)
    assert np.abs(constant[1]) > 0.1


def test_bases_at_other_areas_match_the_same_functions(bases, signatures) -> None:
    source, target = bases
    C = zo.fit_functional_map(source, target.at_area(0.25), *signatures, 8)
    np.testing.assert_allclose(C[:, 0], 0.5 * np.eye(8)[0], atol=1e-9)
    constants = (basis.coefficients(np.ones((1000, 1)))[:8] for basis in (source, target.at_area(0.25)))
    np.testing.assert_allclose(C @ next(constants), next(constants), atol=1e-9)


def test_duplicate_descriptors_do_not_change_the_fit(bases, signatures) -> None:
    once = zo.fit_functional_map(*bases, *signatures, 8)
    twice = zo.fit_functional_map(*bases, *(np.hstack([each, each]) for each in signatures), 8)
    np.testing.assert_allclose(once, twice, atol=1e-6)


def test_descriptor_units_matter_only_without_normalization(bases, signatures) -> None:
    scaled = signatures[0] * 5, signatures[1] * 7
    np.testing.assert_allclose(
        zo.fit_functional_map(*bases, *signatures, 8), zo.fit_functional_map(*bases, *scaled, 8), atol=1e-6
    )
    as_they_are = zo.fit_functional_map(*bases, *scaled, 8, normalize=False)
    assert np.abs(as_they_are - zo.fit_functional_map(*bases, *signatures, 8, normalize=False)).max() > 1e-3


@pytest.mark.parametrize("reflected", [False, True])
@pytest.mark.parametrize("orientation", ["keep", "reverse"])
def test_orientation_distinguishes_a_copy_from_its_mirror_image(
    source, copy, bases, signatures, orientation, reflected
) -> None:
    surface, same = copy
    if reflected:  # a map that preserves the orientation of the copy reverses that of its mirror image
        surface = zo.Surface(surface.vertices * [1, 1, -1], surface.triangles[:, ::-1])
    of_orientation = operators_of(source, (surface, same), bases, signatures, 16)
    C = zo.fit_functional_map(*bases, *signatures, 16, orientation=orientation, orientation_operators=of_orientation)
    found = zo.zoomout(*bases, C, 60).vertex
    across = mirrored_vertex(source, source)[same]
    right, wrong = (same, across) if (orientation == "keep") != reflected else (across, same)
    everywhere = np.arange(len(same))
    assert zo.geodesic_error(found, source.surface, everywhere, right).mean() < 0.03
    assert zo.geodesic_error(found, source.surface, everywhere, wrong).mean() > 0.2


def test_few_descriptors_suffice_with_multiplication_operators(bases, copy) -> None:
    source, target = bases
    f = zo.wave_kernel_map(source, [5], 4)
    maps = [
        zo.fit_functional_map(source, target, f, f[copy[1]], 20, laplacian_weight=0, multiplication_weight=weight)
        for weight in (0.0, 1.0)
    ]
    true = functional_map_of(copy[1], source, target, 20, 20)
    off = [np.linalg.norm(each - true) / np.linalg.norm(true) for each in maps]
    assert off[1] < 0.1 < 0.5 < off[0]


@pytest.mark.parametrize("dense", [0, 10_000])
@pytest.mark.parametrize("value", [0.0, 3.0])
def test_undetermined_entries_stay_zero(bases, value, dense, monkeypatch) -> None:
    monkeypatch.setattr(descriptor_fit, "DENSE", dense)
    same = np.full(1000, value)
    nothing = np.zeros((1, 8, 8)), np.zeros((1, 8, 8))
    C = zo.fit_functional_map(*bases, same, same, 8, laplacian_weight=0, orientation_operators=nothing)
    np.testing.assert_allclose(C, np.diag([1.0] + [0] * 7), atol=1e-4)


def test_invalid_arguments_are_refused(bases, signatures) -> None:
    f, g = signatures
    hole = f.copy()
    hole[0, 0] = np.inf

    def fit(f=f, g=g, k=8, **options):
        return zo.fit_functional_map(*bases, f, g, k, **options)

    def on_a_part():
        part = zo.hamiltonian_basis(creature(1000, seed=0).surface, np.arange(1000) > 500, 20)
        return zo.fit_functional_map(part, bases[1], f, g, 8)

    ones = np.ones((3, 8, 8))
    for wrong, words in (
        (lambda: fit(f[:-1]), "The source's descriptors must have a row for each of the basis's 1000 vertices"),
        (lambda: fit(g=g[:, :5]), "The source has 30 descriptors, but the target has 5"),
        (lambda: fit(f[:, :0], g[:, :0]), "The source's descriptors are empty"),
        (lambda: fit(hole), "must be finite"),
        (lambda: fit(k=61), "k is 61, but the basis has only 60"),
        (lambda: fit(k=(20, 30, 40)), "one for the source and one for the target"),
        (lambda: fit(k=(8, 0)), "k is 0: give a whole number"),
        (on_a_part, "does not begin with the constant function"),
        (lambda: fit(k=1), "the 1 components already have"),
        (lambda: fit(descriptor_weight=-1), "descriptor_weight is -1"),
        (lambda: fit(orientation_weight=float("nan")), "orientation_weight is nan"),
        (lambda: fit(descriptor_weight=0, multiplication_weight=0), "give one to either"),
        (lambda: fit(mask="none"), "say 'eigenvalues' or 'resolvent'"),
        (lambda: fit(orientation="turn"), "say 'keep' or 'reverse'"),
        (lambda: fit(orientation_operators=(ones,)), "those of the source and those of the target"),
        (lambda: fit(orientation_operators=(ones, ones[:2])), "has 3 orientation operators, but the target has 2"),
        (lambda: fit(orientation_operators=(ones, ones[:, :5, :5])), "target's orientation operators have the shape"),
        (lambda: fit(orientation_operators=(ones, np.nan * ones)), "target's orientation operators must be finite"),
    ):
        with pytest.raises(ValueError, match=words):
            wrong()
