# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points attract a target to its source only where they are plausible."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature

from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.registration.correspondences import GeodesicLimit, QueryPoints, Surroundings, residuals
from zoomout_core.samples.spheres import ball

MADE = creature(500, seed=0)
TAIL = MADE.directions[:, 1] > 0.8


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    return analyse(MADE.surface.working.part(0)[0], 60, 300, 0)


def strengths(
    shape: ShapeAnalysis,
    first: np.ndarray | None = None,
    off: float = 0.0,
    facing: float = 1.0,
    sliding: float = 0.02,
    **of_level: float,
) -> np.ndarray:
    """(p,) strength of attraction per area of target places to the source, which is the same shape."""
    n = len(shape.mesh.vertices)
    places = QueryPoints.on(shape, 40)
    limit = GeodesicLimit(np.arange(n) if first is None else first, shape)
    normals = shape.mesh.vertex_normals
    around = Surroundings.of(shape)
    positions = shape.mesh.vertices + off * normals
    _, _, weight = residuals(positions, facing * normals, places, places, around, limit, sliding, **of_level)
    return np.linalg.norm(weight[: len(places.vertex)], axis=(1, 2)) / np.sqrt(places.areas)


def at(shape: ShapeAnalysis, where: np.ndarray) -> np.ndarray:
    return where[QueryPoints.on(shape, 40).vertex]


def test_partner_far_from_the_initial_image_does_not_attract(shape: ShapeAnalysis) -> None:
    first = np.arange(len(TAIL))
    first[TAIL] = np.flatnonzero(MADE.directions[:, 1] < -0.9)[0]
    tail = at(shape, TAIL)
    drawn, undisturbed = strengths(shape, first), strengths(shape)
    assert drawn[tail].max() < 0.1 * undisturbed[tail].min()
    np.testing.assert_allclose(drawn[~tail], undisturbed[~tail])


def test_limit_is_a_distance_along_the_surface(shape: ShapeAnalysis) -> None:
    n = len(TAIL)
    pairs = np.random.default_rng(0).integers(0, n, (2, 2000))
    # By the triangle inequality, this is a lower bound of the geodesic distance.
    lower = np.abs(shape.distances[:, pairs[0]] - shape.distances[:, pairs[1]]).max(axis=0)
    apart = np.linalg.norm(shape.mesh.vertices[pairs[0]] - shape.mesh.vertices[pairs[1]], axis=1)
    limit = GeodesicLimit(np.arange(n), shape).exceeds_geodesic_limit(*pairs)
    assert not limit[lower < 0.1].any()
    assert limit[apart > 0.35].mean() > 0.95
    assert not GeodesicLimit(np.arange(n), shape).exceeds_geodesic_limit(np.arange(n), np.arange(n)).any()


def test_attraction_falls_with_distance_but_never_vanishes(shape: ShapeAnalysis) -> None:
    near, off, far = (np.median(strengths(shape, off=off)) for off in (0.0, 0.03, 0.12))
    assert off < 0.6 * near
    assert 0 < far < 0.2 * near


def test_partners_with_opposite_normals_hardly_attract(shape: ShapeAnalysis) -> None:
    against, along = strengths(shape, facing=-1.0), strengths(shape)
    assert np.median(against) < 0.1 * np.median(along)
    assert against.min() > 0


def test_a_level_says_from_where_on_and_whether_at_all_a_partner_hardly_draws(shape: ShapeAnalysis) -> None:
    wider = np.median(strengths(shape, off=0.12, robust_scale=0.12))
    assert wider > 5 * np.median(strengths(shape, off=0.12))
    elsewhere = np.full(len(TAIL), int(np.argmax(shape.distances[0])))
    assert strengths(shape, elsewhere).min() > 0
    assert strengths(shape, elsewhere, min_weight=0.0).min() == 0


@pytest.mark.parametrize("sliding", [0.01, 0.3])
def test_sliding_reduces_the_attraction_along_the_surface(shape: ShapeAnalysis, sliding: float) -> None:
    n = len(TAIL)
    places = QueryPoints.on(shape, 40)
    normals = shape.mesh.vertex_normals
    vertex, _, weight = residuals(
        shape.mesh.vertices,
        normals,
        places,
        places,
        Surroundings.of(shape),
        GeodesicLimit(np.arange(n), shape),
        sliding,
    )
    across = np.linalg.norm(np.einsum("qij,qj->qi", weight, normals[vertex]), axis=1)
    along = np.cross(normals[vertex], [0.0, 0, 1])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    ratio = np.linalg.norm(np.einsum("qij,qj->qi", weight, along), axis=1) / across
    np.testing.assert_allclose(ratio**2, sliding / (1 + sliding), rtol=1e-6)


def test_correspondences_are_searched_in_both_directions(shape: ShapeAnalysis) -> None:
    # The target lacks the source's tail: source places there attract the nearest target vertices.
    n = len(TAIL)
    places = QueryPoints.on(shape, 40)
    positions = np.where(TAIL[:, None], shape.mesh.vertices - [0, 0.08, 0], shape.mesh.vertices)
    vertex, residual, _ = residuals(
        positions,
        shape.mesh.vertex_normals,
        places,
        places,
        Surroundings.of(shape),
        GeodesicLimit(np.arange(n), shape),
        0.02,
    )
    assert len(vertex) == 2 * len(places.vertex)
    back = residual[len(places.vertex) :][at(shape, TAIL)]
    assert back[:, 1].max() > 0.05


def test_query_points_grow_with_the_nodes_and_cover_the_area(shape: ShapeAnalysis) -> None:
    few, many = QueryPoints.on(shape, 5), QueryPoints.on(shape, 20)
    assert 5 < len(few.vertex) < len(many.vertex)
    for places in (few, many):
        assert places.areas.sum() == pytest.approx(1)
        assert places.areas.min() > 0


# --- two close layers -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def leaf() -> ShapeAnalysis:
    """A flat ellipsoid whose two sides are closer than its vertex spacing."""
    return analyse(ball(1.0, radii=(1, 1, 0.03), count=400).working.part(0)[0], 60, 300, 0)


def middle_of(shape: ShapeAnalysis) -> np.ndarray:
    return np.asarray(np.linalg.norm(shape.mesh.vertices, axis=1) < 0.25)


def test_closest_point_has_a_similar_normal(leaf: ShapeAnalysis) -> None:
    vertices, normals = leaf.mesh.vertices, leaf.mesh.vertex_normals
    inner = middle_of(leaf)
    # Beyond the other side.
    beyond = vertices - 2.5 * vertices * [0, 0, 1]
    for sense in (1, -1):
        found = Surroundings.of(leaf).closest(beyond, sense * normals).interpolate(vertices)
        same = np.sign(found[inner, 2]) == np.sign(vertices[inner, 2])
        assert same.mean() > 0.95 if sense > 0 else same.mean() < 0.05


def test_partners_on_both_shapes_have_similar_normals(leaf: ShapeAnalysis) -> None:
    vertices, normals = leaf.mesh.vertices, leaf.mesh.vertex_normals
    places = QueryPoints.on(leaf, 40)
    limit = GeodesicLimit(np.arange(len(vertices)), leaf)
    beyond = vertices - 2.5 * vertices * [0, 0, 1]
    vertex, residual, _ = residuals(beyond, normals, places, places, Surroundings.of(leaf), limit, 0.02)
    partner = beyond[vertex] + residual
    inner = middle_of(leaf)[vertex]
    count = len(places.vertex)
    for both in (slice(None, count), slice(count, None)):
        same = np.sign(partner[both, 2]) == np.sign(vertices[vertex[both], 2])
        assert same[inner[both]].mean() > 0.95


def test_weights_are_proportional_to_areas_of_both_shapes(leaf: ShapeAnalysis) -> None:
    n = len(leaf.mesh.vertices)
    here, there = QueryPoints.on(leaf, 10), QueryPoints.on(leaf, 20)
    limit = GeodesicLimit(np.arange(n), leaf)
    found = residuals(leaf.mesh.vertices, leaf.mesh.vertex_normals, here, there, Surroundings.of(leaf), limit, 1.0)
    assert len(found[0]) == len(here.vertex) + len(there.vertex)
    np.testing.assert_allclose(found[1], 0, atol=1e-9)
    strength = np.linalg.norm(found[2], axis=(1, 2)) ** 2
    np.testing.assert_allclose(
        strength / np.concatenate([here.areas, there.areas]), strength[0] / here.areas[0], rtol=1e-6
    )


def test_root_of_a_weight_falls_with_the_squared_distance(leaf: ShapeAnalysis) -> None:
    inner = at(leaf, middle_of(leaf))
    near, *others = (strengths(leaf, off=off)[inner] for off in (0.0, 0.01, 0.02, 0.04))
    fallen = [float(np.median(near / other - 1)) for other in others]
    np.testing.assert_allclose([fallen[1] / fallen[0], fallen[2] / fallen[1]], 4, rtol=0.1)
