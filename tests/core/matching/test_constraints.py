# SPDX-License-Identifier: GPL-3.0-or-later
"""Constraints from the user enter the ranking and pin the map."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex

import zoomout_core as zo
from zoomout_core.matching.constraints import MIN_PINNING_WIDTH_RATIO, bend_to_points, landmark_errors
from zoomout_core.mesh.triangles import area_normals
from zoomout_core.samples.grids import grid, grid_faces, triangles_of

pytestmark = pytest.mark.usefixtures("quick_search")


@pytest.fixture(scope="module")
def pair() -> tuple[Creature, Creature]:
    return creature(1500), creature(1200, seed=1, bend=0.4)


def best_and_others(result: zo.MatchResult, score: str) -> tuple[float, list[float]]:
    values = [candidate.scores[score] for candidate in result.candidates]
    return values[0], values[1:]


def test_common_axis_and_regions_favour_the_right_map(pair) -> None:
    source, target = pair
    legs = [np.flatnonzero(side.directions[:, 2] < -0.7) for side in pair]
    tails = [np.flatnonzero(side.directions[:, 1] > 0.8) for side in pair]
    result = zo.match(source.surface, target.surface, common_axes=(0, 0, 2), regions=[legs, tails])
    for score in ("axes", "regions"):
        best, others = best_and_others(result, score)
        assert best < 0.35
        assert best < max(others)
    assert result.candidates[0].anchors is not None


def test_an_earlier_map_is_a_hypothesis_and_evidence(pair) -> None:
    source, target = pair
    earlier = true_vertex(source, target)
    result = zo.match(source.surface, target.surface, initial_map=earlier)
    best, others = best_and_others(result, "earlier map")
    assert best < 0.1 < max(others)
    # Evidence is weighted: the right map wins over a random earlier map.
    wrong = np.random.default_rng(0).permutation(earlier)
    assert zo.match(source.surface, target.surface, initial_map=wrong).candidates[0].scores["earlier map"] > 0.2


def test_exact_landmarks_are_hit(pair) -> None:
    source, target = pair
    truth = true_vertex(source, target)
    target_ids = np.array([10, 300, 600, 900])
    source_ids = truth[target_ids]
    unit = np.sqrt(source.surface.area)

    def missed(exact: bool) -> float:
        landmarks = (source_ids, target_ids)
        surface_map = zo.match(source.surface, target.surface, landmarks=landmarks, exact_landmarks=exact).surface_map
        images = surface_map.interpolate(source.surface.vertices)[target_ids]
        return float(np.linalg.norm(images - source.surface.vertices[source_ids], axis=1).max() / unit)

    assert missed(exact=True) < 1e-6 < missed(exact=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"common_axes": (0, 0, 0)}, "common_axes must be directions"),
        ({"regions": [([0, 1],)]}, "Region 0 must be a pair"),
        ({"regions": [([0, 5000], [1])]}, "Region 0 of the source"),
        ({"exact_landmarks": True}, "exact_landmarks needs `landmarks`"),
        ({"initial": "proximity", "initial_map": [0]}, "not used by initial='proximity'"),
        ({"initial": "proximity", "landmarks": ([0], [0])}, "Landmarks are not used"),
        ({"k_final": 0}, "k_final is 0"),
        ({"samples": 2.5}, "samples is 2.5"),
        ({"step": 0}, "step is 0"),
        ({"proxy_vertices": 5}, "proxy_vertices is 5"),
        ({"partial": "yes"}, "partial is 'yes': choose one of auto, off"),
        ({"proxy_vertices": "few"}, "proxy_vertices is 'few'"),
    ],
)
def test_invalid_arguments_are_refused(pair, arguments, message) -> None:
    with pytest.raises(ValueError, match=message):
        zo.match(pair[0].surface, pair[1].surface, **arguments)


def test_bending_a_map_to_points_flips_no_triangles() -> None:
    faces = triangles_of(grid_faces(30, 30))
    sheet = zo.Surface(grid(np.linspace(0, 1, 31), np.linspace(0, 1, 31)).vertices, faces)
    larger = zo.Surface(3 * sheet.vertices, faces)  # the target may be in another unit
    straight = zo.SurfaceMap.from_vertices(np.arange(31**2), sheet)
    goal, place = np.array([[0.68, 0.5, 0.0]]), 3 * np.array([[0.5, 0.5, 0.0]])
    assert landmark_errors(straight, sheet, larger, goal, place) == pytest.approx([0.18])
    assert landmark_errors(straight, sheet, larger, place / 3, place) == pytest.approx([0], abs=1e-9)

    def turned_over(surface_map: zo.SurfaceMap) -> int:
        return int((area_normals(surface_map.interpolate(sheet.vertices), faces)[:, 2] < 0).sum())

    bent = bend_to_points(straight, sheet, larger, goal, place)
    assert landmark_errors(bent, sheet, larger, goal, place) == pytest.approx([0], abs=1e-6)
    assert turned_over(bent) == 0
    far = np.linalg.norm(sheet.vertices - [0.5, 0.5, 0], axis=1) > 3 * MIN_PINNING_WIDTH_RATIO * 0.18 + 0.1
    np.testing.assert_array_equal(bent.vertex[far], straight.vertex[far])
    # The first of two points at one vertex is used, and the map meets it exactly.
    twice = bend_to_points(straight, sheet, larger, np.vstack([goal, goal + 0.05]), np.vstack([place, place]))
    np.testing.assert_allclose(landmark_errors(twice, sheet, larger, goal, place), 0, atol=1e-6)


def test_bending_continues_across_a_seam_and_keeps_it_closed() -> None:
    side = np.linspace(0, 1, 31)
    faces = triangles_of(grid_faces(30, 30))
    sheet = zo.Surface(grid(side, side).vertices, faces)
    on_seam = np.flatnonzero(np.isclose(sheet.vertices[:, 0], 0.5))
    twin = np.arange(31**2)
    twin[on_seam] = 31**2 + np.arange(31)
    right = sheet.vertices[faces][:, :, 0].mean(axis=1) > 0.5
    torn = np.where(right[:, None], twin[faces], faces)
    split = zo.Surface(np.vstack([sheet.vertices, sheet.vertices[on_seam]]), torn)
    straight = zo.SurfaceMap.from_vertices(np.concatenate([np.arange(31**2), on_seam]), sheet)
    goal, place = np.array([[0.5, 0.6, 0.0]]), np.array([[0.5, 0.5, 0.0]])
    images = bend_to_points(straight, sheet, split, goal, place).interpolate(sheet.vertices)
    np.testing.assert_allclose(images[on_seam], images[31**2 :], atol=1e-9)
    for beside in ([0.4, 0.5, 0], [0.6, 0.5, 0]):
        near = np.argmin(np.linalg.norm(split.vertices - beside, axis=1))
        assert images[near, 1] > 0.51


def test_preimages_of_the_identity_are_the_points_themselves() -> None:
    made = creature(400)
    straight = zo.SurfaceMap.from_vertices(np.arange(400), made.surface)
    points = made.surface.vertices[made.surface.triangles[:20]].mean(axis=1)
    found = straight.preimages(made.surface, made.surface, points)
    np.testing.assert_array_equal(found.triangle, np.arange(20))
    np.testing.assert_allclose(found.interpolate(made.surface.vertices), points, atol=1e-9)
