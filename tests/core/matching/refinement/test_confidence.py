# SPDX-License-Identifier: GPL-3.0-or-later
"""Confidence is low where round trip, eigenfunctions and surroundings disagree with a map, and where it flips."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature
from pieces import analyse_piece, piece_of
from scipy.spatial import cKDTree

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.refinement import confidence as confidence_module
from zoomout_core.matching.refinement.confidence import (
    CONFIDENCE,
    confidence_of,
    cycle_error,
    local_distortion,
    partners_by_cycle,
    spectral_distance,
    torn_triangles,
)
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.tuning import retune

MADE = creature(500, seed=0)
TAIL = MADE.directions[:, 1] > 0.8  # with its surroundings


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    return analyse(MADE.surface.working.part(0)[0], 60, 200, 0)


def vertex_map(vertex: np.ndarray, shape: ShapeAnalysis) -> SurfaceMap:
    found = SurfaceMap.from_vertices(vertex, MADE.surface)
    return SurfaceMap(found.triangle, found.barycentric, shape.mesh.triangles)


def identity(shape: ShapeAnalysis) -> SurfaceMap:
    return vertex_map(np.arange(len(shape.mesh.vertices)), shape)


def shuffled(shape: ShapeAnalysis, where: np.ndarray) -> SurfaceMap:
    """The identity, with some vertices permuted."""
    vertex = np.arange(len(where))
    vertex[where] = np.random.default_rng(0).permutation(vertex[where])
    return vertex_map(vertex, shape)


def elsewhere(shape: ShapeAnalysis, where: np.ndarray) -> SurfaceMap:
    """The identity, but some vertices all map to the first other vertex."""
    vertex = np.arange(len(where))
    vertex[where] = np.flatnonzero(~where)[0]
    return vertex_map(vertex, shape)


def test_exact_map_has_full_confidence(shape: ShapeAnalysis) -> None:
    confidence, over = confidence_of(identity(shape), identity(shape), np.eye(40), shape, shape, False, False)
    assert confidence.min() > 0.99
    assert over == 0


def test_confidence_is_low_where_all_criteria_disagree(shape: ShapeAnalysis) -> None:
    there, back = elsewhere(shape, TAIL), identity(shape)
    confidence, _ = confidence_of(there, back, np.eye(40), shape, shape, False, False)
    assert confidence[TAIL].mean() < 0.3
    assert np.median(confidence[~TAIL]) > 0.8


def test_triangles_around_a_part_that_is_sent_far_away_are_torn(shape: ShapeAnalysis) -> None:
    assert torn_triangles(identity(shape), shape, shape) == 0
    triangles = shape.mesh.triangles
    at_border = TAIL[triangles].any(axis=1) & ~TAIL[triangles].all(axis=1)
    areas = triangle_areas(shape.mesh.vertices, triangles)
    far_away = int(np.argmin(shape.mesh.vertices[:, 1]))
    there = vertex_map(np.where(TAIL, far_away, np.arange(len(TAIL))), shape)
    assert torn_triangles(there, shape, shape) == pytest.approx(areas[at_border].sum() / areas.mean(), rel=1e-9)


def test_one_agreeing_criterion_suffices_for_confidence(shape: ShapeAnalysis) -> None:
    # The way back is wrong, but the eigenfunctions at both ends agree.
    confidence, _ = confidence_of(identity(shape), elsewhere(shape, TAIL), np.eye(40), shape, shape, False, False)
    assert confidence[TAIL].mean() > 0.95
    # The eigenfunctions disagree, but the way back returns to the start.
    signs = np.diag(np.where(np.arange(40) % 2, -1.0, 1.0))
    confidence, _ = confidence_of(identity(shape), identity(shape), signs, shape, shape, False, False)
    assert confidence.mean() > 0.95


@pytest.mark.parametrize(
    ("cycle", "spectral", "distortion", "low", "high"),
    [
        (0.004, 0.004, 1, 0.9, 1.0),
        (0.022, 0.022, 1, 0.4, 0.6),
        (0.025, 0.5, 1, 0.0, 0.1),
        (0.004, 0.12, 1, 0.4, 0.6),
        (0.022, 0.022, 9, 0.0, 0.2),
        (0.022, 0.022, 0.1, 0.8, 1.0),
        (0.022, 0.5, 0.01, 0.7, 1.0),
    ],
)
def test_confidence_halves_at_an_expected_error_of_a_fiftieth(
    shape: ShapeAnalysis,
    monkeypatch: pytest.MonkeyPatch,
    cycle: float,
    spectral: float,
    distortion: float,
    low: float,
    high: float,
) -> None:
    usual = np.full(len(shape.mesh.vertices), CONFIDENCE.usual_residual)
    monkeypatch.setattr(confidence_module, "local_distortion", lambda *_: distortion * usual)
    # The way back ends beside the start, on an edge.
    there = identity(shape)
    corner = np.argmax(there.barycentric, axis=1)
    neighbour = shape.mesh.triangles[there.triangle, (corner + 1) % 3]
    edge = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices[neighbour], axis=1)
    share = np.minimum(cycle / edge, 1)[:, None]
    back = SurfaceMap(
        there.triangle, (1 - share) * np.eye(3)[corner] + share * np.eye(3)[(corner + 1) % 3], shape.mesh.triangles
    )
    # An error in the constant function is the same at all vertices.
    C = np.eye(40)
    C[0, 0] += spectral * np.sqrt(shape.basis.eigenvalues[:40].sum() / 2)
    confidence, _ = confidence_of(there, back, C, shape, shape, False, False)
    assert low <= np.median(confidence) <= high


def test_local_distortion_is_high_at_tears_and_for_reflections(shape: ShapeAnalysis) -> None:
    assert local_distortion(identity(shape), shape, shape, False).max() < 1e-9
    torn = local_distortion(elsewhere(shape, TAIL), shape, shape, False)
    distance = np.linalg.norm(shape.mesh.vertices[:, None] - shape.mesh.vertices[TAIL], axis=2).min(axis=1)
    assert torn[TAIL].min() > 0.5
    assert torn[distance > 0.5].max() < 1e-9
    assert np.median(local_distortion(identity(shape), shape, shape, True)) > 0.1


def test_vertices_beside_an_error_have_less_confidence() -> None:
    # With all these functions nothing is smooth by itself.
    shape = analyse(MADE.surface.working.part(0)[0], 400, 400, 0)
    distance = np.linalg.norm(shape.mesh.vertices[:, None] - shape.mesh.vertices[TAIL], axis=2).min(axis=1)
    confidence, _ = confidence_of(elsewhere(shape, TAIL), identity(shape), np.eye(40), shape, shape, False, False)
    beside, far = (distance > 0.07) & (distance < 0.1), distance > 0.3
    assert confidence[far].mean() > 0.99
    assert confidence[beside].mean() < 0.9


def test_flipped_triangles_have_no_confidence(shape: ShapeAnalysis) -> None:
    confidence, over = confidence_of(identity(shape), identity(shape), np.eye(40), shape, shape, True, False)
    assert over == pytest.approx(1)
    assert confidence.max() < 0.01
    # Swapping two neighbours flips only the triangles around them.
    a, b = shape.mesh.triangles[100, :2]
    vertex = np.arange(len(shape.mesh.vertices))
    vertex[[a, b]] = b, a
    swapped = vertex_map(vertex, shape)
    confidence, over = confidence_of(swapped, swapped, np.eye(40), shape, shape, False, False)
    assert 0 < over < 0.05
    assert ((confidence > 0.05) & (confidence < 0.95)).any()  # by the flipped share around each vertex


def test_vertices_that_do_not_return_have_no_partner(shape: ShapeAnalysis) -> None:
    lost = partners_by_cycle(elsewhere(shape, TAIL), identity(shape), shape, shape)
    for has_partner in lost:
        assert shape.basis.areas[~has_partner].sum() == pytest.approx(shape.basis.areas[TAIL].sum(), rel=0.25)
        assert has_partner[~TAIL].mean() > 0.95
    assert np.concatenate(partners_by_cycle(identity(shape), identity(shape), shape, shape)).all()


def test_area_that_fills_a_hole_has_no_partner() -> None:
    whole = creature(1000, seed=0)
    inside = whole.directions @ [0, -1, 0] > 0.9
    holed = piece_of(whole, ~inside)
    kept = np.flatnonzero(np.isin(whole.directions @ [1, 2, 4], holed.directions @ [1, 2, 4]))
    nearest = cKDTree(holed.surface.vertices).query(whole.surface.vertices)[1]
    there = SurfaceMap.from_vertices(kept, whole.surface)
    back = SurfaceMap.from_vertices(nearest, holed.surface)
    shapes = analyse_piece(whole), analyse_piece(holed)
    # Only the end on the border reveals it: the round trip is short.
    with retune(CONFIDENCE, without_partner=1.0):
        found = partners_by_cycle(there, back, *shapes)
        assert found.target.all()
        assert found.source[kept].all()
        assert found.source[inside].mean() < 0.5
        with retune(CONFIDENCE, beyond_border=1.0):
            assert partners_by_cycle(there, back, *shapes).source.all()


def test_small_errors_do_not_remove_partners(shape: ShapeAnalysis) -> None:
    distance = np.linalg.norm(shape.mesh.vertices[:, None] - shape.mesh.vertices, axis=2)
    np.fill_diagonal(distance, np.inf)
    beside = np.where(distance.min(axis=1) < 0.04, distance.argmin(axis=1), np.arange(len(distance)))
    assert (beside != np.arange(len(beside))).mean() > 0.2
    found = partners_by_cycle(vertex_map(beside, shape), identity(shape), shape, shape)
    assert found.target.mean() > 0.98


@pytest.mark.parametrize("centre", [100, 140, 250])
def test_few_outliers_among_returning_vertices_have_partners(shape: ShapeAnalysis, centre: int) -> None:
    distance = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices[centre], axis=1)
    vertex = np.arange(len(distance))
    vertex[np.argsort(distance)[:3]] = np.argmax(distance)
    there = vertex_map(vertex, shape)
    assert partners_by_cycle(there, identity(shape), shape, shape).target.all()
    with retune(CONFIDENCE, pooling=0.0):
        assert not partners_by_cycle(there, identity(shape), shape, shape).target[centre]


def test_cycle_error_is_a_distance_in_the_unit_of_the_vertices(shape: ShapeAnalysis) -> None:
    back = shuffled(shape, TAIL)
    error = cycle_error(identity(shape), back, 10 * shape.mesh.vertices)
    moved = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices[back.vertex], axis=1)
    np.testing.assert_allclose(error, 10 * moved, atol=1e-9)


def test_spectral_distance_of_a_small_step_is_its_length(shape: ShapeAnalysis) -> None:
    a, b = shape.mesh.triangles[:, 0], shape.mesh.triangles[:, 1]
    step = np.linalg.norm(shape.mesh.vertices[a] - shape.mesh.vertices[b], axis=1)
    rows, values = shape.basis.eigenvectors[:, :30], shape.basis.eigenvalues[:30]
    ratio = spectral_distance(rows[a], rows[b], values) / step
    assert 0.6 < np.median(ratio) < 1.4
