# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks arrive on the right place and side of the target, at any placement and unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from specimens import WALL, grow, hollow

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.pair import LandmarkError
from zoomout_core.matching.registration.smooth_warp import outward_normals, winding_number
from zoomout_core.matching.result import MatchResult
from zoomout_core.matching.transfer_landmarks import LANDMARK_TRANSFER
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral.sampling import farthest_points
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("remember_matches")
COUNT = 1200
OTHER = 1100
FAST = {"k_final": 60}


@pytest.fixture(scope="module")
def source() -> Surface:
    return hollow(COUNT, 0)


@pytest.fixture(scope="module")
def target() -> Surface:
    other = hollow(OTHER, 1)
    return other.with_vertices(grow(other.vertices))


@pytest.fixture(scope="module")
def result(source: Surface, target: Surface) -> MatchResult:
    return zo.match(source, target, **FAST)


def test_landmarks_beat_the_map_and_stay_on_their_side(source: Surface, target: Surface, result: MatchResult) -> None:
    for wall in range(2):
        numbers = wall * COUNT + farthest_points(source.vertices[:COUNT], 20)
        found = zo.transfer_landmarks(result, source.vertices[numbers])
        truth = grow(source.vertices[numbers])
        errors = np.linalg.norm(found.points - truth, axis=1)
        assert np.median(errors) < WALL  # the edges are three times as long
        triangle, _ = closest_points(found.points, target.vertices, target.triangles)
        assert ((target.triangles[triangle, 0] >= OTHER) == wall).all()
        if wall == 0:
            by_map = result.surface_map.preimages(source, target, source.vertices[numbers])
            assert errors.mean() < np.linalg.norm(by_map.interpolate(target.vertices) - truth, axis=1).mean()
            sure = found.confidence > 0.5
            assert 3 * errors[sure].mean() < errors[~sure].mean()


@pytest.mark.slow
def test_placement_and_unit_do_not_matter(source: Surface, target: Surface, result: MatchResult) -> None:
    points = source.vertices[farthest_points(source.vertices[:COUNT], 20)]
    rotation = Rotation.from_rotvec([2.0, 0.5, -1.0])
    turned = target.with_vertices(1000 * rotation.apply(target.vertices) + [5, 0, -900])
    found = zo.transfer_landmarks(zo.match(source, turned, **FAST), points)
    back = rotation.inv().apply(found.points - [5, 0, -900]) / 1000
    assert np.abs(back - zo.transfer_landmarks(result, points).points).max() < 1e-3 * WALL


def test_a_specimen_of_the_same_side_is_no_mirror_image(result: MatchResult) -> None:
    assert zo.mirror_candidate(result) is None


def test_a_landmark_without_a_partner_has_no_confidence(source: Surface, result: MatchResult) -> None:
    alone = replace(result, source_has_partner=np.zeros(len(source.vertices), dtype=bool))
    assert (zo.transfer_landmarks(alone, source.vertices[:3]).confidence == 0).all()


def test_a_wrong_map_has_little_confidence(source: Surface, result: MatchResult) -> None:
    points = source.vertices[farthest_points(source.vertices[:COUNT], 20)]
    order = np.random.default_rng(0).permutation(len(result.surface_map.triangle))
    shuffled = replace(
        result.surface_map,
        triangle=result.surface_map.triangle[order],
        barycentric=result.surface_map.barycentric[order],
    )
    wrong = replace(result, surface_map=shuffled, confidence=np.full(len(order), 0.1))
    assert (zo.transfer_landmarks(wrong, points).confidence < 0.5).all()


@pytest.mark.slow
def test_a_landmark_whose_surroundings_are_missing_has_little_confidence(
    source: Surface, target: Surface, result: MatchResult
) -> None:
    points = source.vertices[farthest_points(source.vertices[:COUNT], 20)]
    sure = np.argmax(zo.transfer_landmarks(result, points).confidence)
    hole = np.linalg.norm(target.vertices - grow(points[[sure]]), axis=1) < 5 * WALL
    kept = target.triangles[~hole[target.triangles].any(axis=1)]
    found = zo.transfer_landmarks(zo.match(source, Surface(target.vertices, kept), **FAST), points[[sure]])
    assert found.confidence < 0.5


@pytest.mark.slow
def test_a_bent_warp_has_little_confidence(source: Surface, result: MatchResult) -> None:
    points = source.vertices[farthest_points(source.vertices[:COUNT], 20)]
    confidence = zo.transfer_landmarks(result, points).confidence
    with retune(LANDMARK_TRANSFER, bent=1e-6):
        assert zo.transfer_landmarks(result, points).confidence.max() < 0.01 * confidence.max()


def test_landmarks_follow_the_map_without_a_smooth_deformation(
    source: Surface, target: Surface, result: MatchResult
) -> None:
    with retune(LANDMARK_TRANSFER, smooth=0.0):
        found = zo.transfer_landmarks(result, np.arange(0, 900, 30))
    by_map = result.surface_map.preimages(source, target, source.vertices[:900:30])
    assert found.points == pytest.approx(by_map.interpolate(target.vertices))
    assert found.confidence == pytest.approx(by_map.interpolate(result.confidence))


@pytest.mark.slow
def test_vertex_numbers_and_positions_give_the_same_landmarks(source: Surface, result: MatchResult) -> None:
    found, same = (zo.transfer_landmarks(result, each) for each in ([3, 90], source.vertices[[3, 90]]))
    assert found.points.tolist() == same.points.tolist()
    with pytest.raises(ValueError, match="Landmarks on the source must be vertex numbers"):
        zo.transfer_landmarks(result, [len(source.vertices)])
    with pytest.raises(LandmarkError, match="away from its surface"):
        zo.transfer_landmarks(result, [[0.0, 0, 90]])


def test_normals_of_a_cavity_point_into_it(source: Surface) -> None:
    mesh = source.working
    normals = outward_normals(mesh)
    assert np.einsum("nx,nx->n", normals[mesh.component == 0], mesh.vertex_normals[mesh.component == 0]).min() > 0.99
    assert np.einsum("nx,nx->n", normals[mesh.component == 1], mesh.vertex_normals[mesh.component == 1]).max() < -0.99
    corners = mesh.vertices[mesh.oriented_triangles[mesh.component[mesh.triangles[:, 0]] == 0]]
    assert winding_number(mesh.vertices[mesh.component == 1][0], corners) == pytest.approx(1, abs=1e-3)
    assert winding_number(np.array([9.0, 0, 0]), corners) == pytest.approx(0, abs=1e-3)
