# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures of a part, parts of a side, and pairing of partners."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from loose_parts import BODY, RADIUS, part_of, sheet

from zoomout_core.matching.components.parts import Part, Side, relation_of
from zoomout_core.matching.components.parts import pair_parts as paired_in_regions
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

EYES = [ball(0.04, (0.35, 0, 0)), ball(0.03, (-0.35, 0, 0))]


def pair_without_regions(ours: list[Part], theirs: list[Part]) -> dict[int, int]:
    """Pair parts without regions."""
    return paired_in_regions(ours, theirs, np.zeros((len(ours), 0), bool), np.zeros((len(theirs), 0), bool))[0]


def balls(*at: tuple[float, float, float], radius: float = 0.1) -> list[Part]:
    return [part_of(ball(radius, place)) for place in at]


# --- a part ---------------------------------------------------------------------------------------------------------


def test_centre_size_and_reach_of_a_part_are_those_of_its_shape() -> None:
    for radius in (0.1, 3.0):
        part = part_of(ball(radius, (1, 2, 3)))
        np.testing.assert_allclose(part.centre, [1, 2, 3], atol=0.02 * radius)
        assert part.size == pytest.approx(radius, rel=0.01)
        assert part.reach == pytest.approx(radius, rel=0.02)
    long = part_of(ball(0.1, radii=(5, 1, 1)))
    assert long.reach == pytest.approx(0.5, rel=0.05)
    assert 0.25 < long.size < 0.35


def test_distance_to_another_part_is_the_root_mean_square() -> None:
    flat = part_of(sheet(0.2, count=20))
    above = part_of(sheet(0.2, (0, 0, 0.05), count=20))
    assert flat.distance_to(above) == pytest.approx(0.05)
    half = part_of(sheet(0.1, (-0.05, 0, 0), 20, length=0.2))
    assert half.distance_to(flat) < 0.01
    # The farther half is off by at most its width.
    assert flat.distance_to(half) == pytest.approx(0.1 / np.sqrt(6), rel=0.3)


def test_distances_along_a_part_ignore_size_place_and_bending() -> None:
    plain = part_of(sheet(0.4)).distances
    np.testing.assert_allclose(part_of(sheet(4.0, (3, 3, 3))).distances, plain, rtol=1e-9)
    x, y, _ = sheet(1.0).vertices.T
    rolled = part_of(sheet(1.0).with_vertices(np.column_stack([np.sin(2 * x) / 2, y, np.cos(2 * x) / 2])))
    np.testing.assert_allclose(rolled.distances, plain, rtol=0.05)
    assert (np.diff(plain) > 0).all()
    # Edge paths across a square of unit area are no longer than from corner to corner.
    assert 0.1 < plain[0] < 0.4 < plain[2] < plain[-1] < 2
    strip = part_of(sheet(2.0, length=0.2)).distances
    assert strip[-1] > 1.5 * plain[-1]


# --- a side ---------------------------------------------------------------------------------------------------------


def test_side_has_all_parts_in_the_unit_of_its_body() -> None:
    surface = Surface.joined([*EYES, BODY.with_vertices(10 * BODY.vertices), ball(2.0, (9, 0, 0))])
    body = surface.working.part(0)[0]
    side = Side.of(surface, body)
    assert side.body == 0
    np.testing.assert_array_equal(np.sort(side.body_vertices), np.flatnonzero(~side.loose))
    np.testing.assert_allclose(np.ptp(side.points[side.body_vertices], axis=0), 2 * RADIUS, rtol=0.05)
    np.testing.assert_allclose(
        side.points[side.body_vertices] - side.points[side.body_vertices].mean(axis=0), body.vertices, atol=1e-9
    )
    parts = side.parts(side.points)
    assert [round(part.size, 4) for part in parts] == sorted((round(part.size, 4) for part in parts), reverse=True)
    np.testing.assert_allclose([part.size for part in parts], [0.2, 0.004, 0.003], rtol=0.03)
    for part in parts:
        assert part.weights.sum() == pytest.approx(1)
        np.testing.assert_array_equal(part.vertices[part.corners], side.mesh.triangles[part.triangles])
    assert sum(len(part.vertices) for part in parts) == side.loose.sum()


def test_parts_are_weighted_by_area_and_slivers_count_little() -> None:
    uneven = sheet(1.0).with_vertices(4 * sheet(1.0).vertices ** 3)
    surface = Surface.joined(
        [BODY.with_vertices(9 * BODY.vertices), uneven, Surface([[0, 0, 9], [1, 0, 9], [2, 1e-12, 9]], [[0, 1, 2]])]
    )
    side = Side.of(surface, surface.working.part(0)[0])
    assert side.areas.min() > 1e-10 * side.areas.mean()
    cloth, *_ = side.parts(side.points)
    np.testing.assert_allclose(cloth.centre, cloth.points.min(axis=0) / 2 + cloth.points.max(axis=0) / 2, atol=1e-9)
    # Variance of a uniform square: a twelfth of the squared side along each axis.
    assert cloth.size == pytest.approx(np.sqrt(2 / 12) * np.ptp(cloth.points[:, 0]), rel=0.08)


def test_all_parts_are_loose_around_a_hull() -> None:
    surface = Surface.joined([*EYES, ball(0.1)])
    hull = replace(BODY.working, is_hull=True)
    side = Side.of(surface, hull)
    assert side.body == -1
    assert side.loose.all()
    assert len(side.parts(side.points)) == len(side.members([])) == 3
    np.testing.assert_allclose(side.points, hull.from_surface(side.mesh.to_surface(side.mesh.vertices)))


def test_part_belongs_to_regions_with_most_of_its_vertices() -> None:
    lone = np.array([[0, 0, 5.0]])
    joined = Surface.joined([BODY, *EYES])
    surface = Surface(np.vstack([joined.vertices, lone]), joined.triangles)
    first = len(BODY.vertices)
    half = np.arange(first, first + 30)
    for body, skipped in ((surface.working.part(0)[0], 1), (replace(BODY.working, is_hull=True), 0)):
        members = partial(Side.of(surface, body).members)
        larger = members([np.arange(first, first + 60), half, np.append(half, first + 30), np.array([first + 120])])
        np.testing.assert_array_equal(larger[-2], [True, False, True, False])
        assert not larger[-1].any()
        assert len(larger) == 3 - skipped
        twice = members([np.repeat(half, 3)])
        assert not twice.any()


def test_membership_needs_more_than_half_of_the_vertices() -> None:
    side = Side.of(Surface.joined(EYES), replace(BODY.working, is_hull=True))
    for first in (0, 60):
        members = side.members([first + np.arange(31), first + np.arange(30)])
        assert members[:, 0].sum() == 1
        assert not members[:, 1].any()


# --- partners -----------------------------------------------------------------------------------------


def test_shared_regions_favour_pairs_and_different_ones_forbid_them() -> None:
    none, one, other, both = [False, False], [True, False], [False, True], [True, True]
    relation = relation_of(np.array([none, one, both]), np.array([none, one, other, both]))
    shared = relation[1, 1]
    assert 0 < shared < 1
    np.testing.assert_allclose(
        relation, [[1, 1, 1, 1], [1, shared, np.inf, (1 + shared) / 2], [1, (1 + shared) / 2, (1 + shared) / 2, shared]]
    )


def test_partners_must_be_in_the_same_place() -> None:
    # The limit depends on the size and on the tolerated error of a map.
    for radius, near, far in ((0.2, 0.08, 0.3), (0.02, 0.02, 0.05)):
        ours = balls((0, 0, 0), radius=radius)
        assert pair_without_regions(ours, balls((near, 0, 0), radius=radius)) == {0: 0}
        assert pair_without_regions(ours, balls((far, 0, 0), radius=radius)) == {}


def test_partners_must_have_similar_size() -> None:
    ours = balls((0, 0, 0))
    for radius, mates in ((0.12, True), (0.08, True), (0.19, False), (0.05, False)):
        assert pair_without_regions(ours, balls((0, 0, 0), radius=radius)) == ({0: 0} if mates else {})


def test_nearest_and_most_similar_part_is_the_partner() -> None:
    ours = balls((0, 0, 0))
    places = [(0.03, 0, 0), (0.01, 0, 0), (0, 0.04, 0)]
    assert pair_without_regions(ours, balls(*places)) == {0: 1}
    sizes = [part_of(ball(radius)) for radius in (0.12, 0.101, 0.09)]
    assert pair_without_regions(ours, sizes) == {0: 1}


def test_pairing_minimises_the_total_distance() -> None:
    # A greedy choice for the first would take the second's only partner.
    ours, theirs = balls((0, 0, 0), (0.04, 0, 0)), balls((0.015, 0, 0), (-0.04, 0, 0))
    assert pair_without_regions(ours, theirs) == {0: 1, 1: 0}
    assert pair_without_regions(ours[:1], theirs) == {0: 0}
    assert pair_without_regions(ours, theirs[:1]) in ({0: 0}, {1: 0})


def test_each_of_many_equal_parts_finds_its_partner() -> None:
    places = [(0.012 * i, 0, 0) for i in range(15)]
    assert pair_without_regions(balls(*places), balls(*places)) == {i: i for i in range(15)}


def test_misfit_is_infinite_only_across_regions() -> None:
    ours, theirs = balls((0, 0, 0), (0.5, 0, 0)), balls((0, 0, 0), (0.5, 0, 0))
    named = np.array([[True, False], [False, True]])
    partners, misfit = paired_in_regions(ours, theirs, named, named)
    assert partners == {0: 0, 1: 1}
    np.testing.assert_array_equal(np.isinf(misfit), ~np.eye(2, dtype=bool))
    np.testing.assert_allclose(np.diag(misfit), 0, atol=1e-9)
    unnamed = paired_in_regions(ours, theirs, named[:, :0], named[:, :0])[1]
    assert np.isfinite(unnamed).all()
    assert unnamed[0, 1] > 1
    assert paired_in_regions(ours, theirs, named, named[::-1])[0] == {}
