# SPDX-License-Identifier: GPL-3.0-or-later
"""Assign sides: signed distances, the line between the sides, and the sides of loose parts and shells."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from butterfly import MIRROR, grid, mirrored_vertex
from creatures import Creature, creature, directions
from scipy.spatial import ConvexHull

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.mesh.surface import Surface
from zoomout_core.symmetry.sides import leftward, on_whole_surface, signed_distance, zero_line

X = np.array([1.0, 0, 0])


@pytest.fixture(scope="module")
def made() -> Creature:
    return creature(400)


@pytest.fixture(scope="module")
def shape(made: Creature) -> ShapeAnalysis:
    return analyse(made.surface.working, 60, 200, 0)


def onto(made: Creature, places: np.ndarray) -> SurfaceMap:
    """The map that sends each vertex to the point whose direction is closest to its entry in places (n, 3)."""
    return SurfaceMap(*closest_points(places, made.directions, made.surface.triangles), made.surface.triangles)


def test_mirror_divides_a_body_into_two_sides(made: Creature, shape: ShapeAnalysis) -> None:
    mirror = onto(made, made.directions * MIRROR)
    distance = signed_distance(mirror, shape)
    assert distance is not None
    x = made.directions[:, 0]
    clear = np.abs(x) > 0.15
    side = np.sign(distance * x)[clear]
    assert (side == side[0]).all()
    assert np.abs(distance + mirror.interpolate(distance)).mean() < 0.1 * np.abs(distance).mean()
    # Near the line, the distance is half the distance between a point and its image.
    near = (np.abs(x) > 0.05) & (np.abs(x) < 0.12) & (made.directions[:, 2] < 0.3) & (made.directions[:, 2] > -0.3)
    half = np.abs(made.surface.working.vertices[:, 0])[near]
    assert np.median(np.abs(distance)[near] / half) == pytest.approx(1, abs=0.35)


def test_point_reflection_has_no_sides() -> None:
    places = directions(400, seed=1)
    ball = Creature(Surface(places, ConvexHull(places).simplices), places)
    shape = analyse(ball.surface.working, 60, 200, 0)
    assert signed_distance(onto(ball, -places), shape) is None
    assert signed_distance(onto(ball, places * MIRROR), shape) is not None


def test_identity_has_no_sides_and_no_left(made: Creature, shape: ShapeAnalysis) -> None:
    same = SurfaceMap.from_vertices(np.arange(len(made.directions)), made.surface)
    assert signed_distance(same, shape) is None
    assert leftward(made.directions[:, 0], same, made.surface, X) == 0


def test_half_noisy_mirror_still_has_sides(made: Creature, shape: ShapeAnalysis) -> None:
    random = np.random.default_rng(0)
    off = np.where(random.random((400, 1)) < 0.5, random.normal(scale=1.0, size=(400, 3)), 0)
    distance = signed_distance(onto(made, made.directions * MIRROR + off), shape)
    assert distance is not None
    x = made.directions[:, 0]
    assert np.abs(np.sign(distance * x)[np.abs(x) > 0.2].mean()) > 0.9


def test_points_left_of_their_images_are_on_the_left() -> None:
    surface = grid()
    there = SurfaceMap.from_vertices(mirrored_vertex(surface), surface)
    x = surface.vertices[:, 0]
    assert leftward(x, there, surface, X) == pytest.approx(1)
    assert leftward(-x, there, surface, X) == pytest.approx(-1)
    assert leftward(x, there, surface, -X) == pytest.approx(-1)
    assert leftward(x, there, surface, np.array([0, 1.0, 0])) == pytest.approx(0)
    assert leftward(x, there, surface, np.array([0.6, 0.8, 0])) == pytest.approx(0.6)
    assert leftward(0 * x, there, surface, X) == 0


def test_left_is_decided_by_area_not_by_vertices() -> None:
    # Two surfaces across the line; the finely divided one votes for the opposite.
    coarse, fine = grid(2, 1, width=2), grid(20, 1, width=2, height=0.1)
    surface = Surface(
        np.concatenate([coarse.vertices, fine.vertices + np.array([0, 3, 0])]),
        np.concatenate([coarse.corner_vertex.reshape(-1, 4), fine.corner_vertex.reshape(-1, 4) + 6]),
    )
    there = SurfaceMap.from_vertices(mirrored_vertex(surface), surface)
    sign = np.where(np.arange(len(surface.vertices)) < 6, 1, -1)
    assert leftward(sign * surface.vertices[:, 0], there, surface, X) > 0.5


# --- loose parts --------------------------------------------------------------------------------------------


def join_at(parts: list[tuple[Surface, np.ndarray]]) -> tuple[Surface, np.ndarray]:
    """Join surfaces at places (3,); also return (n,) the number of each vertex's part."""
    starts = np.cumsum([0, *(len(part.vertices) for part, _ in parts)])
    vertices = np.concatenate([part.vertices + place for part, place in parts])
    faces = np.concatenate(
        [part.corner_vertex.reshape(-1, 4) + start for (part, _), start in zip(parts, starts, strict=False)]
    )
    return Surface(vertices, faces), np.repeat(np.arange(len(parts)), np.diff(starts))


def around(surface: Surface, body: np.ndarray, scale: float, is_hull: bool = False) -> ShapeAnalysis:
    """Stand-in for a shape whose mesh has some vertices (n,) of a surface, at another scale."""
    number = np.where(body, np.cumsum(body) - 1, -1)
    full = SimpleNamespace(vertex_of=number, scale=scale, is_hull=is_hull)
    place = SimpleNamespace(interpolate=lambda values: values)
    return cast(ShapeAnalysis, SimpleNamespace(proxy=SimpleNamespace(full=full, place=place)))


def test_eyes_are_on_the_nearer_side_and_a_nose_on_both() -> None:
    eye = grid(2, 2, width=0.2, height=0.2)
    parts = [(grid(24), np.zeros(3)), (eye, np.array([0.3, 1.3, 0])), (eye, np.array([-0.3, 1.3, 0]))]
    surface, part = join_at([*parts, (eye, np.array([0, 1.3, 0]))])
    there = SurfaceMap.from_vertices(mirrored_vertex(surface), surface)
    x, body = surface.vertices[:, 0], part == 0
    scale = 5.0
    distance = on_whole_surface(x[body] / scale, there, around(surface, body, scale), surface)
    np.testing.assert_allclose(distance[body], x[body])
    # Half the distance between vertices and their images.
    np.testing.assert_allclose(distance[~body], x[~body], atol=1e-9)


def test_loose_part_is_on_the_side_of_its_majority() -> None:
    eye = grid(10, 2, width=1.0, height=0.1)
    surface, part = join_at([(grid(), np.zeros(3)), (eye, np.array([0.4, 1.1, 0])), (eye, np.array([-0.4, 1.3, 0]))])
    image = np.arange(len(part))
    image[part == 0] = mirrored_vertex(grid())
    image[part == 1] = np.flatnonzero(part == 2)[::-1]
    image[part == 2] = np.flatnonzero(part == 1)[::-1]
    there = SurfaceMap.from_vertices(image, surface)
    body = part == 0
    distance = on_whole_surface(surface.vertices[body, 0], there, around(surface, body, 1.0), surface)
    assert (distance[part == 1] > 0).all()
    assert (distance[part == 2] < 0).all()


@pytest.mark.parametrize(("reach", "whole"), [(0.1, True), (0.45, False)])
def test_shell_with_a_partner_is_on_one_side_if_mostly_there(reach: float, whole: bool) -> None:
    """A shell beside the line reaches across it by a fraction of its width."""
    shell = grid(20, 2, width=1.0, height=0.3)
    middle = 0.5 - reach
    surface, part = join_at(
        [(grid(), np.zeros(3)), (shell, np.array([middle, 2, 0])), (shell, np.array([-middle, 3, 0]))]
    )
    image = np.arange(len(part))
    image[part == 0] = mirrored_vertex(grid())
    # Reverse the order of the vertex columns.
    reverse = np.arange(21 * 3).reshape(21, 3)[::-1].ravel()
    image[part == 1], image[part == 2] = np.flatnonzero(part == 2)[reverse], np.flatnonzero(part == 1)[reverse]
    there = SurfaceMap.from_vertices(image, surface)
    everything = np.ones(len(part), dtype=bool)
    skin = around(surface, everything, 2.0, is_hull=True)
    distance = on_whole_surface(surface.vertices[:, 0] / 2, there, skin, surface)
    x = surface.vertices[:, 0]
    np.testing.assert_allclose(np.abs(distance), np.abs(x), atol=1e-9)
    np.testing.assert_allclose(distance[part == 0], x[part == 0], atol=1e-9)
    beyond = (part == 1) & (x < -1e-9)
    assert beyond.any()
    assert (distance[beyond] > 0).all() == whole
    assert (distance[beyond] < 0).all() != whole


def test_shell_without_a_partner_is_on_both_sides() -> None:
    surface, _ = join_at([(grid(24), np.zeros(3)), (grid(24), np.array([0.75, 2, 0]))])
    there = SurfaceMap.from_vertices(mirrored_vertex(surface), surface)
    skin = around(surface, np.ones(len(surface.vertices), dtype=bool), 1.0, is_hull=True)
    x = surface.vertices[:, 0]
    distance = on_whole_surface(x, there, skin, surface)
    np.testing.assert_array_equal(np.sign(distance), np.sign(np.round(x, 9)))


def test_distances_around_shells_are_made_antisymmetric() -> None:
    surface = grid()
    there = SurfaceMap.from_vertices(mirrored_vertex(surface), surface)
    skin = around(surface, np.ones(len(surface.vertices), dtype=bool), 1.0, is_hull=True)
    distance = on_whole_surface(surface.vertices[:, 0] + 0.3, there, skin, surface)
    np.testing.assert_allclose(distance, surface.vertices[:, 0], atol=1e-12)


# --- the line -----------------------------------------------------------------------------------------------


def test_zero_line_of_a_linear_function_is_one_curve() -> None:
    surface = grid(11, 7)
    value = surface.vertices @ np.array([1.0, 0.31, 0]) - 0.12
    line = zero_line(value, surface)
    np.testing.assert_allclose(line.points @ np.array([1.0, 0.31, 0]), 0.12, atol=1e-12)
    ends = surface.vertices[line.edges]
    assert ((value[line.edges] > 0).sum(axis=1) == 1).all()
    between = np.linalg.norm(ends - line.points[:, None], axis=2).sum(axis=1)
    np.testing.assert_allclose(between, np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
    (curve,) = line.polylines
    assert sorted(curve.tolist()) == list(range(len(line.points)))
    heights = line.points[curve, 1]
    assert (np.diff(heights) > 0).all() or (np.diff(heights) < 0).all()
    assert sorted(heights[[0, -1]]) == pytest.approx([0, 1])


def test_closed_curves_end_where_they_begin_and_open_ones_come_first() -> None:
    surface = grid(40, 20, width=4, height=2)
    x, y = surface.vertices[:, 0], surface.vertices[:, 1]
    value = np.minimum(np.hypot(x + 1, y - 1) - 0.5, 1 - x)
    curves = zero_line(value, surface).polylines
    assert len(curves) == 2
    assert curves[0][0] != curves[0][-1]
    assert curves[1][0] == curves[1][-1]
    assert len(np.unique(curves[1])) == len(curves[1]) - 1


def test_zero_line_is_empty_without_a_sign_change() -> None:
    surface = grid()
    line = zero_line(np.ones(len(surface.vertices)), surface)
    assert line.points.shape == (0, 3)
    assert line.polylines == []
