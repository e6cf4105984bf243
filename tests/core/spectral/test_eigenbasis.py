# SPDX-License-Identifier: GPL-3.0-or-later
"""The eigenbasis is complete, exact, orthonormal, and depends only on the shape."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, directions
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU, eigsh
from scipy.spatial import ConvexHull
from threadpoolctl import threadpool_info, threadpool_limits

import zoomout_core as zo
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral import eigenbasis as module
from zoomout_core.spectral import lanczos
from zoomout_core.spectral.eigenbasis import eigenbasis
from zoomout_core.spectral.lanczos import _is_complete, eigenpairs
from zoomout_core.spectral.laplacian import mesh_laplacian


def test_eigenpairs_agree_with_arpack(resting: Creature) -> None:
    working = resting.surface.working
    basis = eigenbasis(resting.surface, 80)
    stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
    values, vectors = eigsh(stiffness, 80, diags_array(areas), sigma=-1.0)
    np.testing.assert_allclose(basis.eigenvalues, values, rtol=1e-5, atol=1e-5)
    # Both span the same space; signs and bases of repeated eigenvalues may differ.
    cosines = np.linalg.svd(vectors[:, :79].T @ (areas[:, None] * basis.eigenvectors), compute_uv=False)
    assert cosines.min() > 1 - 1e-5


def test_eigenfunctions_are_orthonormal_under_areas_that_sum_to_one(resting: Creature) -> None:
    basis = eigenbasis(resting.surface, 60)
    np.testing.assert_allclose(basis.areas.sum(), 1, rtol=1e-12)
    np.testing.assert_allclose(basis.coefficients(basis.eigenvectors), np.eye(60), atol=1e-5)


@pytest.mark.parametrize("count", [900, 5000])
def test_sphere_has_its_analytic_eigenvalues(count: int) -> None:
    points = directions(count, seed=3)
    eigenvalues = eigenbasis(Surface(points, ConvexHull(points).simplices), 49).eigenvalues
    degree = np.repeat(np.arange(7), 2 * np.arange(7) + 1)
    # At unit area the radius is 1 / sqrt(4 pi).
    np.testing.assert_allclose(eigenvalues[1:], (4 * np.pi * degree * (degree + 1))[1:], rtol=100 / count)


def test_every_component_has_a_constant_eigenfunction(resting: Creature) -> None:
    surface, n = resting.surface, len(resting.surface.vertices)
    both = Surface(
        np.vstack([surface.vertices, surface.vertices + 50]),
        np.vstack([surface.triangles, surface.triangles + n]),
    )
    single, double = eigenbasis(surface, 21).eigenvalues, eigenbasis(both, 40).eigenvalues
    assert (double[:2] < 1e-4).all()
    np.testing.assert_allclose(double[2:], 2 * np.repeat(single[1:20], 2), rtol=1e-4)


def test_spectrum_does_not_depend_on_units_placement_or_vertex_order(resting: Creature) -> None:
    random = np.random.default_rng(0)
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    order = random.permutation(len(resting.surface.vertices))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    moved = Surface((resting.surface.vertices @ rotation * 1000 + 7)[order], place[resting.surface.triangles])
    first, second = eigenbasis(resting.surface, 50), eigenbasis(moved, 50)
    np.testing.assert_allclose(second.eigenvalues, first.eigenvalues, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(second.areas, first.areas[order], rtol=1e-9)


def test_split_vertices_share_the_area_and_unused_ones_have_none(resting: Creature) -> None:
    surface = resting.surface
    soup = Surface(
        np.vstack([surface.vertices[surface.triangles].reshape(-1, 3), [[1e6, 0, 0]]]),
        np.arange(surface.triangles.size).reshape(-1, 3),
    )
    basis, whole = eigenbasis(soup, 30), eigenbasis(surface, 30)
    np.testing.assert_allclose(basis.eigenvalues, whole.eigenvalues, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(basis.coefficients(basis.eigenvectors), np.eye(30), atol=1e-5)
    assert basis.areas[-1] == 0
    assert not basis.eigenvectors[-1].any()


def test_the_same_seed_gives_the_same_basis(resting: Creature) -> None:
    first, second = eigenbasis(resting.surface, 40, seed=5), eigenbasis(resting.surface, 40, seed=5)
    assert np.array_equal(first.eigenvectors, second.eigenvectors)


def test_point_cloud_approximates_the_spectrum_of_its_sphere() -> None:
    eigenvalues = eigenbasis(PointCloud(directions(4000, seed=1)), 9).eigenvalues
    np.testing.assert_allclose(eigenvalues[1:], 4 * np.pi * np.repeat([2.0, 6.0], [3, 5]), rtol=0.05)


@pytest.mark.parametrize("places", [[0, 0, 0], [1, 2, 3]])
def test_points_that_span_no_surface_are_refused(places: list[int]) -> None:
    with pytest.raises(MeshError, match="No surface"):
        eigenbasis(PointCloud(np.arange(50.0)[:, None] * places), 10)


@pytest.mark.parametrize("k", [0, 4000, 5000])
def test_impossible_numbers_of_eigenfunctions_are_refused(resting: Creature, k: int) -> None:
    with pytest.raises(MeshError, match="request fewer"):
        eigenbasis(resting.surface, k)


def test_invalid_shapes_and_counts_are_refused(resting: Creature) -> None:
    for shape in (resting.surface.vertices, [], None, resting):
        with pytest.raises(TypeError, match=r"A mesh is needed, not a \w+: give"):
            eigenbasis(shape, 10)
    for k in (10.0, "10", None):
        with pytest.raises(TypeError, match=r"is .*: give a whole number\.$"):
            eigenbasis(resting.surface, k)


def test_a_mesh_with_slivers_and_non_manifold_edges_has_a_basis(resting: Creature) -> None:
    surface, n = resting.surface, len(resting.surface.vertices)
    a, b, c = surface.triangles[0]
    middle = (surface.vertices[a] + surface.vertices[b]) / 2
    fin = surface.vertices[c] * 1.02
    broken = Surface(
        np.vstack([surface.vertices, [middle, fin]]),
        np.vstack([surface.triangles, [[a, b, n], [a, b, n + 1]]]),  # a face of zero area, and a fin on an edge
    )
    eigenvalues = eigenbasis(broken, 30).eigenvalues
    np.testing.assert_allclose(eigenvalues, eigenbasis(surface, 30).eigenvalues, rtol=0.02, atol=1e-4)


def test_missing_eigenvalues_are_detected(resting: Creature) -> None:
    working = resting.surface.working
    stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
    values = eigenbasis(resting.surface, 60).eigenvalues
    assert _is_complete(values, 50, stiffness, areas)
    for missing in (1, 20, 49):
        assert not _is_complete(np.delete(values, missing), 50, stiffness, areas)


def test_iteration_continues_until_the_spectrum_is_complete(resting: Creature, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the completeness check fails at first, the iteration goes on and finds the same eigenvalues."""
    working = resting.surface.working
    stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
    expected = eigenbasis(resting.surface, 60).eigenvalues
    answers = iter([False, False, True])
    monkeypatch.setattr(lanczos, "_is_complete", lambda *_: next(answers))
    values, _ = eigenpairs(stiffness, areas, 60)
    assert next(answers, None) is None
    np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-5)


def test_out_of_memory_falls_back_to_a_coarser_mesh(
    resting: Creature, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    exact = eigenbasis(resting.surface, 30)
    factorised = lanczos.factorise

    def with_little_memory(matrix: csc_array) -> SuperLU:
        if matrix.shape[0] > 2500:
            raise MemoryError
        return factorised(matrix)

    monkeypatch.setattr(lanczos, "factorise", with_little_memory)
    monkeypatch.setattr(module, "COARSE_VERTICES", 2000)
    basis = eigenbasis(resting.surface, 30)
    assert "not enough memory" in caplog.text
    assert basis.eigenvectors.shape == exact.eigenvectors.shape
    np.testing.assert_allclose(basis.coefficients(basis.eigenvectors), np.eye(30), atol=1e-6)
    assert (basis.eigenvalues[1:] > 0.999 * exact.eigenvalues[1:]).all()
    np.testing.assert_allclose(basis.eigenvalues[1:], exact.eigenvalues[1:], rtol=0.1)
    cosines = np.linalg.svd(exact.coefficients(basis.eigenvectors), compute_uv=False)
    assert cosines[:20].min() > 0.98


def test_blas_thread_count_is_restored(resting: Creature) -> None:
    with threadpool_limits(2, user_api="blas"):
        eigenbasis(resting.surface, 20)
        assert {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"} == {2}


@pytest.mark.parametrize("count", [1, 5, 8])
def test_results_do_not_depend_on_the_number_of_threads(
    resting: Creature, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results are bitwise equal, with thresholds lowered so that several threads share these short vectors."""
    monkeypatch.setattr(lanczos, "MIN_THREADED_VERTICES", 100)
    monkeypatch.setattr(lanczos, "MIN_SPARSE_VERTICES", 200)

    def basis(threads: int) -> np.ndarray:
        zo.set_threads(threads)
        try:
            return eigenbasis(resting.surface, 40).eigenvectors
        finally:
            zo.set_threads(None)

    assert np.array_equal(basis(count), basis(2))
