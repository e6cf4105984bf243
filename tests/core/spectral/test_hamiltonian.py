# SPDX-License-Identifier: GPL-3.0-or-later
"""Hamiltonian eigenfunctions are confined to low potential and keep maps of parts inside their regions."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, directions, true_vertex
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU
from scipy.spatial import ConvexHull

import zoomout_core as zo
from zoomout_core.spectral import eigenbasis, lanczos

# Eigenvalues of a hemisphere whose sphere has unit area, for functions that vanish on the equator: l of degree l.
DEGREE = np.repeat([1, 2, 3], [1, 2, 3])
HEMISPHERE = 4 * np.pi * DEGREE * (DEGREE + 1)


def test_zero_potential_gives_the_ordinary_basis(resting: Creature) -> None:
    basis, hamiltonian = zo.eigenbasis(resting.surface, 30), zo.hamiltonian_basis(resting.surface, np.zeros(4000), 30)
    np.testing.assert_allclose(hamiltonian.eigenvalues, basis.eigenvalues, atol=1e-6)
    np.testing.assert_allclose(hamiltonian.eigenvectors, basis.eigenvectors, atol=1e-4)
    np.testing.assert_array_equal(hamiltonian.areas, basis.areas)


@pytest.mark.parametrize("count", [900, 3000])
def test_strong_potential_acts_as_dirichlet_boundary(count: int) -> None:
    points = directions(count, seed=3)
    sphere, beyond = zo.Surface(points, ConvexHull(points).simplices), points[:, 2] < 0
    eigenvalues = zo.hamiltonian_basis(sphere, beyond, 6, strength=10_000).eigenvalues
    np.testing.assert_allclose(eigenvalues, HEMISPHERE, rtol=0.1)


def test_functions_are_orthonormal_and_confined_to_low_potential(resting: Creature) -> None:
    beyond = resting.directions[:, 0] < 0.1
    basis = zo.hamiltonian_basis(resting.surface, beyond, 40)
    np.testing.assert_allclose(basis.coefficients(basis.eigenvectors), np.eye(40), atol=1e-5)
    mass = basis.areas[beyond] @ basis.eigenvectors[beyond] ** 2
    assert mass.max() < 0.01
    # By the minimax principle a higher potential raises every eigenvalue.
    weaker, stronger = (zo.hamiltonian_basis(resting.surface, beyond, 40, each).eigenvalues for each in (3, 30))
    assert (weaker < basis.eigenvalues).all()
    assert (basis.eigenvalues < stronger).all()


def test_clouds_and_split_vertices_have_the_spectrum_of_their_surface() -> None:
    points = directions(3000, seed=1)
    beyond = points[:, 2] < 0
    cloud = zo.hamiltonian_basis(zo.PointCloud(points), beyond, 6, strength=10_000)
    assert cloud.eigenvectors.shape == (3000, 6)
    np.testing.assert_allclose(cloud.eigenvalues, HEMISPHERE, rtol=0.1)
    sphere = zo.Surface(points, ConvexHull(points).simplices)
    corners = sphere.triangles.ravel()
    soup = zo.Surface(points[corners], np.arange(len(corners)).reshape(-1, 3))
    whole, split = (zo.hamiltonian_basis(sphere, beyond, 6), zo.hamiltonian_basis(soup, beyond[corners], 6))
    np.testing.assert_allclose(split.eigenvalues, whole.eigenvalues, rtol=1e-5)
    np.testing.assert_allclose(split.areas.sum(), 1)


def test_out_of_memory_falls_back_to_a_coarser_mesh(
    resting: Creature, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    beyond = resting.directions[:, 0] < 0.1
    exact = zo.hamiltonian_basis(resting.surface, beyond, 30)
    factorised = lanczos.factorise

    def with_little_memory(matrix: csc_array) -> SuperLU:
        if matrix.shape[0] > 2500:
            raise MemoryError
        return factorised(matrix)

    monkeypatch.setattr(lanczos, "factorise", with_little_memory)
    monkeypatch.setattr(eigenbasis, "COARSE_VERTICES", 2000)
    basis = zo.hamiltonian_basis(resting.surface, beyond, 30)
    assert "not enough memory" in caplog.text
    np.testing.assert_allclose(basis.coefficients(basis.eigenvectors), np.eye(30), atol=1e-6)
    np.testing.assert_allclose(basis.eigenvalues[:20], exact.eigenvalues[:20], rtol=0.1)
    assert np.linalg.svd(exact.coefficients(basis.eigenvectors), compute_uv=False)[:20].min() > 0.98
    assert (basis.areas[beyond] @ basis.eigenvectors[beyond] ** 2).max() < 0.02


def test_signatures_skip_only_constant_functions() -> None:
    """A sphere with a potential on its upper half, beside a small free one: one function is constant."""
    points = directions(900, seed=3)
    triangles = ConvexHull(points).simplices
    sphere, above = zo.Surface(points, triangles), points[:, 2] > 0
    alone = zo.hamiltonian_basis(sphere, above, 8)
    assert alone.components == 0
    lowest = zo.wave_kernel_signature(alone, 1, k=1)  # signature of the first function alone
    np.testing.assert_allclose(lowest[:, 0], alone.eigenvectors[:, 0] ** 2)
    both = zo.Surface(np.vstack([points, 0.5 * points + [3, 0, 0]]), np.vstack([triangles, triangles + 900]))
    basis = zo.hamiltonian_basis(both, np.append(above, np.zeros(900, dtype=bool)), 8)
    assert basis.components == 1
    assert basis.eigenvalues[0] < 1e-6 < basis.eigenvalues[1]
    assert zo.hamiltonian_basis(both, np.zeros(1800), 8).components == 2


def test_zoomout_with_hamiltonian_basis_finds_a_part_on_the_whole(resting: Creature) -> None:
    """ZoomOut starts from a half-wrong map and uses functions confined to the same region of the whole."""
    bent = creature(2500, seed=1, bend=0.5)
    inside = (bent.directions[:, 0] > 0.1)[bent.surface.triangles].all(axis=1)
    used, triangles = np.unique(bent.surface.triangles[inside], return_inverse=True)
    part = zo.Surface(bent.surface.vertices[used], triangles.reshape(-1, 3))
    truth = true_vertex(resting, bent)[used]
    random = np.random.default_rng(0)
    start = np.where(random.random(len(truth)) < 0.5, random.integers(4000, size=len(truth)), truth)
    outside = resting.directions[:, 0] < 0.1
    basis_part = zo.eigenbasis(part, 60).at_area(part.area / resting.surface.area)
    basis_whole = zo.hamiltonian_basis(resting.surface, outside, 60)
    vertex = zo.zoomout(basis_whole, basis_part, start, k_final=60).vertex
    assert outside[start].mean() > 0.2
    assert outside[vertex].mean() < 0.01
    assert off(resting, vertex, truth) < 0.3 * off(resting, start, truth)
    # A region that misses some of the part gives a worse map.
    lacking = zo.hamiltonian_basis(resting.surface, resting.directions[:, 0] < 0.5, 60)
    assert off(resting, zo.zoomout(lacking, basis_part, start, k_final=60).vertex, truth) > off(resting, vertex, truth)


def off(source: Creature, vertex: np.ndarray, truth: np.ndarray) -> float:
    """Mean Euclidean distance between images and true images on the source."""
    return float(np.linalg.norm(source.surface.vertices[vertex] - source.surface.vertices[truth], axis=1).mean())


@pytest.mark.parametrize(
    ("potential", "arguments", "sentence"),
    [
        (np.zeros(7), {}, r"must be 4000 numbers, one for each vertex, not float64 \(7,\)"),
        (np.zeros((4000, 1)), {}, "must be 4000 numbers"),
        (np.full(4000, "a"), {}, "must be 4000 numbers"),
        (np.full(4000, np.nan), {}, "from 0 to 1, and nan is not"),
        (np.full(4000, 1.5), {}, r"from 0 to 1, and 1\.5 is not"),
        (np.full(4000, -0.1), {}, r"and -0\.1 is not"),
        (np.ones(4000), {}, "below 1 at 0 vertices, too few for 10"),
        (np.arange(4000) > 8, {}, "below 1 at 9 vertices"),
        (np.zeros(4000), {"strength": -1.0}, r"strength is -1\.0"),
        (np.zeros(4000), {"strength": np.nan}, "strength is nan"),
        (np.zeros(4000), {"strength": "high"}, "strength is 'high'"),
    ],
)
def test_invalid_potentials_are_refused(resting: Creature, potential, arguments, sentence) -> None:
    with pytest.raises(ValueError, match=sentence) as refusal:
        zo.hamiltonian_basis(resting.surface, potential, 10, **arguments)
    assert "\n" not in str(refusal.value)


def test_invalid_shapes_and_counts_are_refused(resting: Creature) -> None:
    with pytest.raises(TypeError, match="A mesh is needed"):
        zo.hamiltonian_basis(resting.surface.vertices, np.zeros(4000), 10)
    for k in (0, 4000):
        with pytest.raises(zo.MeshError, match="a mesh of 4,000 vertices has at most 3,999"):
            zo.hamiltonian_basis(resting.surface, np.zeros(4000), k)
    with pytest.raises(TypeError, match="give a whole number"):
        zo.hamiltonian_basis(resting.surface, np.zeros(4000), 10.0)
