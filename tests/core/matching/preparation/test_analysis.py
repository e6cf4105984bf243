# SPDX-License-Identifier: GPL-3.0-or-later
"""Analysis of a shape: distances, neighbourhoods, curvature, and functions that distinguish left from right."""

from __future__ import annotations

from functools import partial
from typing import NoReturn

import numpy as np
import pytest
from creatures import creature
from reports import fractions_of
from scipy.sparse.csgraph import dijkstra

from zoomout_core.matching.partial.incomplete_shape import at_scale
from zoomout_core.matching.preparation import analysis
from zoomout_core.matching.preparation.analysis import ANALYSIS, ShapeAnalysis, analyse
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.spectral.descriptors import pseudo_scalar_signatures, signature_bands

COUNT = 300


def part_of(count: int) -> WorkingMesh:
    return creature(count).surface.working.part(0)[0]


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    """A shape whose vertices are all samples."""
    return analyse(part_of(COUNT), 60, COUNT, 0)


def test_distances_are_edge_paths_from_the_first_samples(shape: ShapeAnalysis) -> None:
    graph = edge_graph(shape.mesh.vertices, shape.mesh.triangles)
    between = dijkstra(graph, indices=shape.sampled.samples)
    known = len(shape.distances)
    assert 100 <= known < COUNT
    np.testing.assert_array_equal(shape.distances, between[:known])
    np.testing.assert_allclose(shape.distances_between, between[:known, shape.sampled.samples], rtol=1e-6)
    nearest = shape.nearest_distance_sample
    assert nearest.shape == (COUNT,)
    np.testing.assert_array_equal(
        shape.distances_between[nearest, np.arange(COUNT)], shape.distances_between.min(axis=0)
    )


def test_small_mesh_limits_functions_and_samples() -> None:
    shape = analyse(part_of(30), 60, 10, 0)
    assert shape.basis.eigenvectors.shape == (30, 29)
    assert len(shape.sampled.samples) == 29


def test_progress_rises_in_steps_to_nearly_one() -> None:
    for count, proxy_vertices in ((COUNT, None), (2000, 500)):
        fractions = fractions_of(partial(analyse, part_of(count), 20, 200, 0, proxy_vertices))
        assert fractions[0] < 0.31
        assert fractions == sorted(fractions)
        assert max(np.diff(fractions)) < 0.66
        assert 0.8 < fractions[-1] < 1


def test_distances_on_a_larger_mesh_report_more_steps() -> None:
    samples = np.arange(100)
    few, many = (len(fractions_of(partial(analysis._distances, part_of(count), samples))) for count in (COUNT, 3000))
    assert 4 < few < many < len(samples)


def test_memory_error_is_reported_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*_: object) -> NoReturn:
        raise MemoryError

    monkeypatch.setattr(analysis, "_distances", exhausted)
    with pytest.raises(MeshError, match="not enough memory to analyze a mesh of 300 vertices"):
        analyse(part_of(COUNT), 20, 100, 0)


def test_surroundings_are_gaussian_and_neighbours_mutual(shape: ShapeAnalysis) -> None:
    weights, near = shape.surroundings
    known = len(shape.distances)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-5)
    between = shape.distances_between[:, :known]
    relative = weights / np.diag(weights)[:, None]
    assert (relative[between < 0.05] > 0.8).all()
    assert (relative[between > 0.6] < 0.01).all()
    # A Gaussian: its logarithm is quadratic in the distance.
    far = (between > 0.1) & (between < 0.4)
    rates = np.log(relative[far]) / between[far] ** 2
    np.testing.assert_allclose(rates, rates[0], rtol=1e-3)
    np.testing.assert_array_equal(near, near.T)
    assert not np.diag(near).any()
    assert near.sum(axis=1).mean() < 12
    for one, row in zip(near, between, strict=True):
        assert one[np.argsort(row)[1 : ANALYSIS.neighbours + 1]].all()


def test_cells_contain_the_vertices_nearest_to_a_sample(shape: ShapeAnalysis) -> None:
    owner = shape.distances.argmin(axis=0)
    indicators = (owner[:, None] == np.arange(len(shape.distances))).astype(float)
    np.testing.assert_allclose(shape.cell_coefficients, shape.basis.coefficients(indicators), atol=1e-12)


def test_coordinates_are_eigenfunctions_over_their_eigenvalues(shape: ShapeAnalysis) -> None:
    areas = shape.basis.areas[shape.search.samples]
    np.testing.assert_allclose(areas @ shape.coordinates, 0, atol=1e-9)  # the constant function is excluded
    sizes = np.sqrt(areas @ shape.coordinates**2)
    np.testing.assert_allclose(sizes * shape.basis.eigenvalues[1 : len(sizes) + 1], 1)


def test_curvature_has_zero_mean_and_is_sorted_coarse_to_fine(shape: ShapeAnalysis) -> None:
    samples = shape.search.samples
    areas, curvature = shape.basis.areas[samples], shape.curvature
    np.testing.assert_allclose(areas @ curvature, 0, atol=1e-9)
    assert (np.ptp(curvature, axis=0) < 2).all()
    at = np.empty_like(curvature)
    at[samples] = curvature
    roughness = (at * (shape.stiffness @ at)).sum(axis=0) / (areas @ curvature**2)
    assert (np.diff(roughness) > 0).all()
    # Tips are convex, and the body is flatter between them.
    reach = np.linalg.norm(shape.mesh.vertices[samples], axis=1)
    assert (curvature[reach > np.quantile(reach, 0.97)] > 0).all()
    assert curvature[reach < np.median(reach)].mean() < 0


def test_curvature_of_a_scaled_shape_has_zero_mean(shape: ShapeAnalysis) -> None:
    scaled = at_scale(shape, 0.5)
    np.testing.assert_allclose(scaled.basis.areas @ scaled.vertex_curvature, 0, atol=1e-9)
    np.testing.assert_array_equal(scaled.curvature, scaled.vertex_curvature[scaled.search.samples])


def test_mirror_image_flips_only_the_sign_of_pseudo_scalars(shape: ShapeAnalysis) -> None:
    surface = creature(COUNT).surface
    mirror = type(surface)(surface.vertices * [-1, 1, 1], surface.triangles[:, ::-1])
    mirrored = analyse(mirror.working.part(0)[0], 60, COUNT, 0)
    np.testing.assert_array_equal(mirrored.search.samples, shape.search.samples)
    np.testing.assert_allclose(mirrored.pseudo_scalars, -shape.pseudo_scalars, atol=1e-5)
    ours, theirs = ([one.basis.eigenvectors @ each for each in one.descriptors] for one in (shape, mirrored))
    np.testing.assert_allclose(ours[0], theirs[0], atol=1e-5)
    np.testing.assert_allclose(ours[1], -theirs[1], atol=1e-5)


def test_pseudo_scalars_at_samples_and_as_coefficients_agree(shape: ShapeAnalysis) -> None:
    signatures, pairs = shape.descriptors
    count = signatures.shape[1]
    assert pairs.shape[1] == shape.pseudo_scalars.shape[1] == (count - 1) * (count - 2) // 2
    np.testing.assert_allclose(np.linalg.norm(pairs, axis=0), 1)
    at = np.empty_like(shape.pseudo_scalars)
    at[shape.search.samples] = shape.pseudo_scalars
    # High frequencies are damped but not removed.
    raw = pseudo_scalar_signatures(shape.mesh, shape.basis.areas, signature_bands(shape.basis, count, 60))
    damping = shape.basis.coefficients(at)[:, 0] / shape.basis.coefficients(raw)[:, 0]
    assert (np.diff(damping[1:]) < 0).all()
    assert 0.3 < damping[-1] < 0.95
    same = shape.basis.coefficients(at)
    np.testing.assert_allclose(pairs, same / np.linalg.norm(same, axis=0), atol=1e-9)
