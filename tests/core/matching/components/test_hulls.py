# SPDX-License-Identifier: GPL-3.0-or-later
"""Hulls around bodies: coverage, orientation of open shells, and choice of the body."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from creatures import directions
from loose_parts import egg
from reports import fractions_of
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from zoomout_core.matching.components import bodies
from zoomout_core.matching.components.bodies import find_bodies, tight_bodies
from zoomout_core.matching.components.hulls import (
    _principal_axes,
    hull_of,
    main_part_coverage,
    orient_outwards,
    shares_of_outside,
)
from zoomout_core.matching.components.overlap import leaves_in_place, overlapping
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import analyse
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.progress import advance
from zoomout_core.samples import spheres


def ball(radius: float = 1.0, centre: tuple[float, float, float] = (0, 0, 0), count: int = 300) -> Surface:
    return spheres.ball(radius, centre, count=count)


# --- coverage of a hull -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("radius", "low", "high"), [(0.99, 0.99, 1.0), (0.93, 0.9, 1.0), (0.7, 0.0, 0.01)])
def test_main_part_covers_the_hull_where_it_is_near(radius: float, low: float, high: float) -> None:
    hull = ball().working  # unit area, so the radius is 0.28
    both = Surface.joined([ball(radius), ball(0.05, (1.05, 0, 0))])
    assert low <= main_part_coverage(both, hull) <= high


def test_only_the_largest_part_counts_as_a_main_part() -> None:
    hull = ball().working
    half = ball(0.99)
    upper = half.triangles[half.vertices[half.triangles][:, :, 2].min(axis=1) > 0]
    lower = half.triangles[half.vertices[half.triangles][:, :, 2].max(axis=1) < -0.3]
    both = Surface.joined([Surface(half.vertices, upper), Surface(half.vertices, lower)])
    assert 0.3 < main_part_coverage(both, hull) < 0.7


# --- orientation of open shells -----------------------------------------------------------------------------------


def test_open_shells_face_outwards_and_closed_ones_stay() -> None:
    hull = ball().working
    plate = np.array([[x, y, 0.98] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    inside = ball(0.3)
    for corners in ([[0, 2, 3], [0, 3, 1]], [[0, 3, 2], [0, 1, 3]]):
        both = Surface.joined([inside, Surface(plate, corners)])
        mesh = orient_outwards(both.working, hull)
        centre = mesh.vertices[mesh.oriented_triangles].mean(axis=1)
        a, b, c = mesh.vertices[mesh.oriented_triangles].transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        on_plate = mesh.component[mesh.triangles[:, 0]] == 1
        assert (normal[on_plate, 2] > 0).all()
        middle = centre[~on_plate].mean(axis=0)
        assert (np.einsum("ij,ij->i", normal, centre - middle)[~on_plate] > 0).all()


def test_open_shells_all_around_face_outwards() -> None:
    hull = ball().working
    square = np.array([[x, y, 0.98] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    turns = Rotation.from_rotvec(
        np.pi / 2 * np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [0, 1, 0], [0, 3, 0]])
    )
    plates = [
        Surface(turn.apply(square), [[0, 2, 3], [0, 3, 1]][:: 1 if i % 2 else -1]) for i, turn in enumerate(turns)
    ]
    flipped = [Surface(plate.vertices, plate.triangles[:, ::-1]) for plate in plates]
    for both in (plates, flipped):
        mesh = orient_outwards(Surface.joined([ball(0.3), *both]).working, hull)
        a, b, c = mesh.to_surface(mesh.vertices)[mesh.oriented_triangles].transpose(1, 0, 2)
        assert (np.einsum("mx,mx->m", np.cross(b - a, c - a), a) > 0).all()


def test_closed_shell_is_wound_by_its_volume_not_by_the_hull() -> None:
    hull = ball().working
    inwards = replace(hull, flipped=~hull.flipped)
    mesh = Surface.joined([ball(0.9), ball(0.2, (0.6, 0, 0))]).working
    np.testing.assert_array_equal(orient_outwards(mesh, inwards).flipped, mesh.flipped)


def test_a_strand_with_an_open_end_is_wound_by_its_volume() -> None:
    # It is in the hull with the side that faces away from the nearest part of it.
    inner = ball(0.2, (0.6, 0, 0), count=400)
    open_end = inner.vertices[inner.triangles][:, :, 0].min(axis=1) > 0.78
    strand = Surface(inner.vertices, inner.triangles[~open_end])
    hull = ball().working
    mesh = Surface.joined([ball(0.9), strand]).working
    for skin in (hull, replace(hull, flipped=~hull.flipped)):
        np.testing.assert_array_equal(orient_outwards(mesh, skin).flipped, mesh.flipped)


def test_tight_hull_is_on_the_surface_and_a_plain_one_above() -> None:
    # A needle, which has a small voxel grid, and an unused point.
    needle = ball(1.0, count=600)
    surface = Surface(np.vstack([needle.vertices * [1, 0.05, 0.05], [[0, 0, 3]]]), needle.triangles)
    for tight, voxel, least, most in ((False, 2 / 128, -0.8, -0.2), (True, 2 / 192, -0.2, 0.5)):
        hull = hull_of(surface, tight)
        found = hull.to_surface(hull.vertices)
        middle = np.abs(found[:, 0]) < 0.5
        below = 0.05 * np.sqrt(1 - found[middle, 0] ** 2) - np.linalg.norm(found[middle, 1:], axis=1)
        assert least < np.median(below) / voxel < most
        assert hull.is_hull
        assert hull.vertex_of[-1] == -1 < hull.vertex_of[:-1].min()
        assert len(hull.triangle_of) == 0
        near = np.linalg.norm(found[hull.vertex_of[:-1]] - surface.vertices[:-1], axis=1)
        assert near.max() < 3 * voxel


@pytest.mark.parametrize("sense", [[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1], [-1, -1, -1]])
def test_principal_axes_are_right_handed(sense: list[int]) -> None:
    where = directions(300, 2)
    points = (where + 0.9 * np.maximum(where, 0) ** 2) * [3.0, 2.0, 1.0] * sense
    axes = _principal_axes(Surface(points, ConvexHull(where).simplices).working)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert np.sign(axes[0, 0]) == sense[0]
    assert np.sign(axes[1, 1]) == sense[1]


def test_principal_axes_rotate_with_the_surface() -> None:
    points, corners = egg((3, 2, 1), 2, 300)
    axes = _principal_axes(Surface(points, corners).working)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert np.abs(axes[0, 0]) > 0.9
    assert axes[0, 0] > 0  # towards the longer tail
    assert axes[1, 1] > 0.9
    turn = Rotation.from_rotvec([2.0, 0.5, -1.0]).as_matrix()
    np.testing.assert_allclose(_principal_axes(Surface(points @ turn.T, corners).working), axes @ turn.T, atol=1e-6)


# --- choice of the body -------------------------------------------------------------------------------------------


def bodies_to_try(monkeypatch: pytest.MonkeyPatch, covered: float, too_small: bool = False) -> list[str]:
    """Bodies to try, in order, for a surface of two parts; the larger one covers `covered` of the hull."""
    surface = Surface.joined([ball(), ball(0.5, (1.2, 0, 0))])

    def main_parts(*_: object) -> tuple[str, str]:
        if too_small:
            raise MeshError("too small")
        return "main", "main"

    monkeypatch.setattr(bodies, "cached_hull", lambda *_: "skin")
    monkeypatch.setattr(bodies, "main_part_coverage", lambda *_: covered)
    monkeypatch.setattr(bodies, "shares_of_outside", lambda *_: np.array([covered, 1 - covered]))
    monkeypatch.setattr(bodies, "main_parts", main_parts)
    return [str(one.source) for one in find_bodies(surface, surface, 0)]


@pytest.mark.parametrize(
    ("covered", "first"), [(0.95, ["main", "skin"]), (0.7, ["skin", "main"]), (0.3, ["skin"]), (0.85, ["skin", "main"])]
)
def test_main_part_is_the_body_if_it_covers_nearly_all_the_hull(monkeypatch, covered, first) -> None:
    assert bodies_to_try(monkeypatch, covered) == first


@pytest.mark.parametrize(("one", "other", "first"), [(0.7, 0.71, "main"), (0.7, 1.0, "skin"), (1.0, 0.9, "skin")])
def test_hulls_come_first_if_only_one_outside_shows_other_parts(monkeypatch, one, other, first) -> None:
    pair = [Surface.joined([ball(size), ball(0.5, (1.2, 0, 0))]) for size in (1.0, 0.9)]
    share = {id(surface): part for surface, part in zip(pair, (one, other), strict=True)}
    monkeypatch.setattr(bodies, "cached_hull", lambda *_: "skin")
    monkeypatch.setattr(bodies, "main_part_coverage", lambda *_: 0.99)
    monkeypatch.setattr(bodies, "shares_of_outside", lambda surface, _: np.array([share[id(surface)], 0]))
    monkeypatch.setattr(bodies, "main_parts", lambda *_: ("main", "main"))
    assert find_bodies(pair[0], pair[1], 0)[0].source == first


def test_shares_of_the_outside_are_visible_areas() -> None:
    both = Surface.joined([ball(), ball(0.2, (1.3, 0, 0)), ball(0.3)])
    shares = shares_of_outside(both, hull_of(both))
    assert shares == pytest.approx([1 / 1.04, 0, 0.04 / 1.04], abs=0.01)  # the larger of the two small ones is inside


def test_only_the_hull_is_tried_if_the_main_part_is_too_small(monkeypatch) -> None:
    assert bodies_to_try(monkeypatch, 0.95, too_small=True) == ["skin"]


def test_coverage_is_the_lower_one_of_both_main_parts(monkeypatch) -> None:
    surfaces = [Surface.joined([ball(size), ball(0.5, (2, 0, 0))]) for size in (1.0, 0.9)]
    covered = {id(surfaces[0]): 0.95, id(surfaces[1]): 0.6}
    monkeypatch.setattr(bodies, "cached_hull", lambda *_: SimpleNamespace())
    monkeypatch.setattr(bodies, "main_part_coverage", lambda surface, _: covered[id(surface)])
    monkeypatch.setattr(bodies, "shares_of_outside", lambda *_: np.ones(2) / 2)
    for pair in (surfaces, surfaces[::-1]):
        tried = find_bodies(pair[0], pair[1], 0)
        assert [one.coverage for one in tried] == [1.0, 0.6]


def test_surfaces_of_one_part_need_no_hull(monkeypatch) -> None:
    monkeypatch.setattr(bodies, "cached_hull", lambda *_: pytest.fail("a skin was made"))
    one, other = ball(count=100), ball(2.0, count=80)
    (found,) = find_bodies(one, other, 0)
    assert found.coverage == 1
    assert (len(found.source.vertices), len(found.target.vertices)) == (100, 80)


def test_hulls_replace_both_surfaces_and_may_be_tight(monkeypatch) -> None:
    pair = [Surface.joined([ball(size), ball(0.5, (2, 0, 0))]) for size in (1.0, 0.9)]
    monkeypatch.setattr(bodies, "cached_hull", lambda surface, tight=False: (surface is pair[0], tight))
    monkeypatch.setattr(bodies, "main_part_coverage", lambda *_: 0.3)
    shares = np.ones(2) / 2
    monkeypatch.setattr(bodies, "shares_of_outside", lambda *_: shares)
    (around,) = find_bodies(pair[0], pair[1], 0)
    assert around == ((True, False), (False, False), 1.0, shares)
    assert tight_bodies(pair[0], pair[1], shares) == ((True, True), (False, True), 1.0, shares)


def test_progress_never_falls_and_ends_at_one(monkeypatch) -> None:
    surface = Surface.joined([ball(), ball(0.5, (1.2, 0, 0))])

    def main_parts(*_: object) -> tuple[str, str]:
        advance(0.0)
        advance(1.0)
        return "main", "main"

    monkeypatch.setattr(bodies, "cached_hull", lambda *_: "skin")
    monkeypatch.setattr(bodies, "main_part_coverage", lambda *_: 0.95)
    monkeypatch.setattr(bodies, "shares_of_outside", lambda *_: np.array([0.95, 0.05]))
    monkeypatch.setattr(bodies, "main_parts", main_parts)
    fractions = fractions_of(lambda: find_bodies(surface, surface, 0))
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1
    assert 0.3 < fractions[-2] == fractions[-3] < 0.9


# --- surfaces in the same place -----------------------------------------------------------------------------------


def overlap(source: Surface, target: Surface) -> bool:
    shapes = (analyse(one.working.part(0)[0], 30, 60, 0) for one in (source, target))
    return overlapping(Pair(source, target, *shapes, 30, 20)) is not None


def test_surfaces_overlap_only_if_nearly_all_of_both_does() -> None:
    assert overlap(ball(), ball(count=250))
    assert overlap(ball(), ball(1.05, count=250))
    assert overlap(ball(), ball(1.085, count=250))
    assert not overlap(ball(), ball(1.3, count=250))
    assert not overlap(ball(1.3), ball(count=250))


@pytest.mark.parametrize(("at", "stays"), [(0.9, True), (0.6, False)])
def test_overlap_tolerates_a_small_missing_area(at: float, stays: bool) -> None:
    whole = ball(count=600)
    cut = Surface(whole.vertices, whole.triangles[whole.vertices[whole.triangles][:, :, 2].max(axis=1) < at])
    assert overlap(cut, whole) is stays
    assert overlap(whole, Surface(1.03 * cut.vertices, cut.triangles)) is stays


def test_piece_in_place_overlaps_its_whole() -> None:
    whole = ball(count=600)
    piece = Surface(whole.vertices, whole.triangles[whole.vertices[whole.triangles][:, :, 2].max(axis=1) < 0])
    assert overlap(whole, piece)
    assert not overlap(whole, Surface(piece.vertices + np.array([0, 0, 0.1]), piece.triangles))


@pytest.mark.parametrize(
    ("moved", "part", "stays"), [(0.05, 1.0, True), (0.2, 1.0, False), (1.0, 0.1, True), (1.0, 0.3, False)]
)
def test_map_leaves_in_place_if_little_area_moves(moved: float, part: float, stays: bool) -> None:
    places = np.random.default_rng(0).standard_normal((200, 3))
    images = places.copy()
    images[: round(200 * part), 0] += moved
    still = np.tile(np.eye(3), (200, 1, 1))
    assert leaves_in_place(images, places, np.ones(200), still) is stays
    # Weighted by area, not by number.
    weights = np.where(np.arange(200) < round(200 * part), 1e-6, 1.0)
    assert leaves_in_place(images, places, weights, still) is (stays or part < 1)
    heavy = np.where(np.arange(200) < round(200 * part), 1e6, 1.0)
    assert leaves_in_place(images, places, heavy, still) is (moved < 0.1)
