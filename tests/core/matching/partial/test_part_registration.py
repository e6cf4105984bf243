# SPDX-License-Identifier: GPL-3.0-or-later
"""A part bent onto a whole fits with little strain only in the right place."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import true_vertex
from pieces import PartAndWhole, analyse_piece, piece_of

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.partial.incomplete_shape import INCOMPLETE, IncompleteShape, at_scale
from zoomout_core.matching.partial.part_registration import PART_REGISTRATION, RegisteredPart, register_part
from zoomout_core.matching.registration.correspondences import Surroundings
from zoomout_core.matching.registration.nonrigid_icp import Level
from zoomout_core.tuning import retune

LEVELS = (*PART_REGISTRATION.coarse, *PART_REGISTRATION.fine)


@pytest.fixture(scope="module")
def fitted(lower: PartAndWhole) -> RegisteredPart:
    return register_part(lower.true_places(), lower.part, lower.whole, LEVELS)


def test_part_is_registered_where_it_belongs(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    errors = lower.errors(fitted.closest.vertex)
    assert np.median(errors) < 0.04
    assert np.median(fitted.residual) < 0.01
    assert np.median(fitted.agreement) > 0.97
    assert fitted.is_near.mean() > 0.9
    np.testing.assert_allclose(np.linalg.norm(fitted.normals, axis=1), 1, atol=1e-9)
    determinant = np.linalg.det(fitted.rotations)
    np.testing.assert_allclose(determinant, 1, atol=1e-6)


def test_wrong_place_has_more_strain_and_worse_normals(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    points = lower.whole.shape.mesh.vertices[lower.whole.shape.search.samples[: len(lower.whole.between)]]
    elsewhere = points[lower.true_places()] * [-1, 1, -1]  # maps the legs to the arms
    match = np.argmin(np.linalg.norm(points - elsewhere[:, None], axis=2), axis=1)
    wrong = register_part(match, lower.part, lower.whole, LEVELS)
    areas = lower.part.shape.basis.areas
    right, astray = fitted.scores(areas), wrong.scores(areas)
    assert astray["strain"] > 1.5 * right["strain"]
    assert astray["normals"] > 2 * right["normals"]


def test_scores_do_not_depend_on_the_unit_of_areas(fitted: RegisteredPart) -> None:
    areas = np.linspace(1, 2, len(fitted.residual))
    assert fitted.scores(areas) == pytest.approx(fitted.scores(7 * areas))


def test_whole_does_not_attract_the_borders_of_the_part(lower: PartAndWhole) -> None:
    """Half of the whole has no partner; if it attracted the part, it would stretch the part's borders over itself.

    Softer parts with more sliding would stretch more, by 0.07 at these levels.
    """
    soft = Level(100, 1.0, 0.3, 1), Level(100, 1.1, 0.003, 8)
    fitted = register_part(lower.true_places(), lower.part, lower.whole, soft)
    true = lower.whole.shape.mesh.vertices[true_vertex(lower.made_whole, lower.made_part)]
    off = np.linalg.norm(fitted.positions - true, axis=1)
    assert off[lower.part.cut_distance_of_vertices < 0.05].mean() < 0.02


def test_vertices_that_jump_to_another_limb_are_not_near(lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch) -> None:
    part, whole = lower.part.shape, lower.whole.shape
    closest, tip = Surroundings.closest, part.mesh.vertices[:, 0] > np.quantile(part.mesh.vertices[:, 0], 0.9)
    astray = np.flatnonzero(tip & ~np.isin(np.arange(len(tip)), part.search.samples))
    across = np.argmin(whole.mesh.vertices[whole.mesh.triangles].mean(axis=1)[:, 0])

    def confused(around: Surroundings, positions: np.ndarray, normals: np.ndarray) -> SurfaceMap:
        found = closest(around, positions, normals)
        if len(positions) != len(tip):
            return found
        triangle = found.triangle.copy()
        triangle[astray] = across
        return SurfaceMap(triangle, found.barycentric, found.source_triangles)

    monkeypatch.setattr(Surroundings, "closest", confused)
    is_near = register_part(lower.true_places(), lower.part, lower.whole, LEVELS).is_near
    assert len(astray) > 10
    assert not is_near[astray].any()
    assert np.delete(is_near, astray).mean() > 0.95


@pytest.fixture(scope="module")
def both_cut(lower: PartAndWhole) -> PartAndWhole:
    """The part, and a whole without the feet that the part has."""
    made = piece_of(lower.made_whole, lower.made_whole.directions[:, 2] > -0.8)
    whole = analyse_piece(made)
    unit = whole.proxy.full.scale / lower.whole.shape.proxy.full.scale
    return PartAndWhole(lower.made_part, made, lower.part, IncompleteShape(at_scale(whole, unit)))


def test_area_beyond_a_cut_of_the_whole_is_not_scored(both_cut: PartAndWhole) -> None:
    areas, feet = both_cut.part.shape.basis.areas, both_cut.made_part.directions[:, 2] < -0.85
    fitted, unaware = (
        register_part(both_cut.true_places(), both_cut.part, whole, LEVELS)
        for whole in (both_cut.whole, without_cuts(both_cut.whole))
    )
    assert 0.02 < feet.mean() < 0.3
    assert fitted.on_cut[feet].mean() > 0.9
    assert fitted.on_cut[~feet].mean() < 0.2
    assert not unaware.on_cut.any()
    scores, all_of_it = fitted.scores(areas), unaware.scores(areas)
    assert scores["beyond"] == pytest.approx(areas[fitted.on_cut].sum() / areas.sum())
    assert scores["normals"] < 0.8 * all_of_it["normals"]
    assert scores["strain"] < 0.9 * all_of_it["strain"]


def test_area_beyond_a_cut_of_the_whole_is_not_attracted_to_it(both_cut: PartAndWhole) -> None:
    soft = Level(100, 1.0, 0.3, 1), Level(100, 1.1, 0.003, 8)
    feet = both_cut.made_part.directions[:, 2] < -0.85
    height = [
        np.median(register_part(both_cut.true_places(), both_cut.part, whole, soft).positions[feet, 2])
        for whole in (both_cut.whole, without_cuts(both_cut.whole))
    ]
    assert height[0] < height[1] - 0.01


def without_cuts(shape: IncompleteShape) -> IncompleteShape:
    """The same shape with its cuts undetected."""
    with retune(INCOMPLETE, loop=10.0):
        unaware = IncompleteShape(shape.shape)
        assert np.isinf(unaware.cut_distance_of_vertices).all()
    return unaware
