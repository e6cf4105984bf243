# SPDX-License-Identifier: GPL-3.0-or-later
"""Unaffected quantities of a cut shape: lengths in one unit, distances and areas up to the cut."""

from __future__ import annotations

import numpy as np
from creatures import creature, true_vertex
from pieces import PartAndWhole, analyse_piece, piece_of

from zoomout_core.arrays import Floats
from zoomout_core.matching.partial.incomplete_shape import INCOMPLETE, IncompleteShape, at_scale, unlikeness
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.grids import grid_faces
from zoomout_core.tuning import retune


def grid_shape(size: int = 31, turned_over: bool = False) -> ShapeAnalysis:
    """A square of unit area; vertex i * size + j is at (i, j) / (size - 1), up to a shift of the centre."""
    i, j = np.divmod(np.arange(size**2), size)
    quads = grid_faces(size - 1, size - 1)
    triangles = np.concatenate([quads[:, [0, 1, 3]], quads[:, [3, 1, 2]]])
    surface = Surface(np.column_stack([i, j, 0 * i]) / (size - 1), triangles[:, ::-1] if turned_over else triangles)
    return analyse(surface.working.part(0)[0], 30, 100, 0)


def places(shape: IncompleteShape) -> Floats:
    return shape.shape.mesh.vertices[shape.shape.search.samples[: len(shape.between)]]


def test_scaling_changes_all_lengths_but_not_the_placement() -> None:
    shape = analyse_piece(creature(400))
    twice = at_scale(shape, 2.0)
    assert at_scale(shape, 1.0) is shape
    np.testing.assert_allclose(twice.mesh.vertices, 2 * shape.mesh.vertices)
    np.testing.assert_allclose(twice.distances, 2 * shape.distances)
    np.testing.assert_allclose(twice.basis.areas.sum(), 4)
    np.testing.assert_allclose(twice.basis.eigenvalues, shape.basis.eigenvalues / 4)
    np.testing.assert_allclose(twice.basis.coefficients(twice.basis.eigenvectors), np.eye(60), atol=1e-9)
    np.testing.assert_allclose(twice.basis.points, twice.mesh.vertices)
    np.testing.assert_allclose(twice.search.rows, shape.search.rows / 2)
    full = shape.proxy.full
    np.testing.assert_allclose(twice.proxy.full.to_surface(2 * full.vertices), full.to_surface(full.vertices))
    assert twice.proxy.mesh is twice.proxy.full


def test_scaled_proxy_keeps_its_frame() -> None:
    shape = analyse(creature(900).surface.working.part(0)[0], 30, 100, 0, 500)
    twice = at_scale(shape, 2.0)
    assert len(twice.mesh.vertices) < 900
    np.testing.assert_allclose(twice.proxy.frame[1], shape.proxy.frame[1])
    np.testing.assert_allclose(twice.proxy.vertices, 2 * shape.proxy.vertices)


def test_only_long_borders_are_cuts() -> None:
    square = IncompleteShape(grid_shape())
    x, y = places(square)[:, :2].T
    middle = square.shape.mesh.vertices[:, :2].mean(axis=0)
    to_border = 0.5 - np.maximum(np.abs(x - middle[0]), np.abs(y - middle[1]))
    np.testing.assert_allclose(square.cut_distance, to_border, atol=1e-9)
    with retune(INCOMPLETE, loop=5.0):
        assert np.isinf(IncompleteShape(grid_shape()).cut_distance).all()
    assert np.isinf(IncompleteShape(analyse_piece(creature(400))).cut_distance).all()


def test_fragment_has_cuts_through_its_body_not_only_holes() -> None:
    made = creature(800)
    assert not IncompleteShape(analyse_piece(made)).is_fragment
    pierced = IncompleteShape(analyse_piece(piece_of(made, np.arange(len(made.directions)) != 0)))
    assert np.isfinite(pierced.cut_distance).all()
    assert not pierced.is_fragment
    half = IncompleteShape(analyse_piece(piece_of(made, made.directions[:, 2] < 0)))
    assert half.is_fragment
    # The share refers to the shape's own area, in any unit.
    assert IncompleteShape(at_scale(half.shape, 0.2)).is_fragment
    with retune(INCOMPLETE, fragment=0.0):
        assert IncompleteShape(pierced.shape).is_fragment


def test_unaffected_distances_equal_those_of_the_whole() -> None:
    made = creature(800)
    kept = made.directions[:, 2] < 0.4
    kept[np.argmax(made.directions @ [0, -1, 0])] = False  # and a hole in the belly
    shapes = analyse_piece(made), analyse_piece(piece_of(made, kept))
    whole, part = (IncompleteShape(at_scale(shape, shape.proxy.full.scale)) for shape in shapes)
    vertices = np.flatnonzero(kept)[part.shape.search.samples[: len(part.between)]]
    true = np.array([whole.shape.distances[:, v] for v in vertices])  # distances from the whole's places
    nearest = true.argmin(axis=1)
    at_place = true.min(axis=1) == 0  # the whole has a place at the same vertex
    assert at_place.sum() > 10
    pairs = np.ix_(at_place, at_place)
    longer = part.between[pairs] - whole.between[np.ix_(nearest[at_place], nearest[at_place])]
    unaffected = part.unaffected[pairs]
    assert np.abs(longer[unaffected]).max() < 1e-9
    assert longer[~unaffected].max() > 0.01
    assert whole.unaffected.all()


def test_areas_of_balls_are_those_of_discs_up_to_the_border() -> None:
    square = IncompleteShape(grid_shape(61))
    radius = np.array(INCOMPLETE.radii)
    # Edge paths make balls of the taxicab metric, which the diagonals of one direction enlarge.
    inside = (radius > 0.15) & (radius < square.cut_distance[:, None])
    discs = np.exp(square.log_ball_areas) / radius**2
    assert inside.sum() > 50
    assert 2 < discs[inside].min() < discs[inside].max() < np.pi
    assert (np.diff(square.log_ball_areas, axis=1) >= 0).all()


def test_areas_of_places_add_up_to_the_area_of_the_shape() -> None:
    square = IncompleteShape(grid_shape())
    np.testing.assert_allclose(square.areas.sum(), square.shape.basis.areas.sum())
    assert 0 < square.areas.min() < square.areas.max() < 0.1


def test_unlikeness_is_zero_for_itself_and_robust_to_cuts(lower: PartAndWhole) -> None:
    whole, part = lower.whole, lower.part
    assert unlikeness(whole, whole).diagonal().max() == 0
    unlike = unlikeness(part, whole)
    assert 0 <= unlike.min() < unlike.max() <= 1
    true = true_vertex(lower.made_whole, lower.made_part)[part.shape.search.samples[: len(part.between)]]
    at_truth = unlike[np.arange(len(unlike)), np.argmin(whole.shape.distances[:, true], axis=0)]
    # A random place would rank behind half of all places.
    assert np.mean(unlike < at_truth[:, None]) < 0.3
    np.testing.assert_allclose(unlike, unlikeness(whole, part).T, atol=1e-12)
    # If the cut is unknown, places beside it differ from themselves.
    with retune(INCOMPLETE, loop=10.0):
        unaware = IncompleteShape(part.shape)
        blind = unlikeness(unaware, whole)[np.arange(len(unlike)), np.argmin(whole.shape.distances[:, true], axis=0)]
    near = part.cut_distance < 0.1
    assert blind[near].mean() > 2 * at_truth[near].mean()


def test_unlikeness_is_zero_where_cuts_reach_both_balls() -> None:
    half = IncompleteShape(analyse_piece(piece_of(made := creature(600), made.directions[:, 2] < 0.3)))
    other = IncompleteShape(analyse_piece(piece_of(made, made.directions[:, 2] > -0.3)))
    on_cuts = np.ix_(half.cut_distance == 0, other.cut_distance == 0)
    assert unlikeness(half, other)[on_cuts].size > 0
    assert (unlikeness(half, other)[on_cuts] == 0).all()
