# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders between the parts that a target receives from are clean lines, and covered parts are not on the outside."""

from __future__ import annotations

import numpy as np

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.matching.components.part_borders import PART_BORDERS, straighten_borders
from zoomout_core.matching.components.part_motions import PartMotions
from zoomout_core.matching.components.parts import Side
from zoomout_core.matching.components.shell_images import SHELL_IMAGES, Image, find_covered, uncover
from zoomout_core.mesh.triangles import vertex_areas
from zoomout_core.tuning import retune

# The error of the map's places, at right angles to the sheets.
NOISE = 5e-5


def sheet(low: float, high: float, height: float = 0.0, side: int = 41) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a rectangle from `low` to `high`, of width one."""
    x, y = np.meshgrid(np.linspace(low, high, side), np.linspace(0, 1, side), indexing="ij")
    number = np.arange(side * side).reshape(side, side)
    a, b, c, d = (each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1), triangles


def both(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> zo.Surface:
    return zo.Surface(np.vstack([one[0], other[0]]), np.vstack([one[1], other[1] + len(one[0])]))


def side_of(surface: zo.Surface) -> Side:
    mesh = surface.working
    return Side(mesh, surface.vertices, vertex_areas(surface.vertices, mesh.triangles), np.zeros(0, dtype=np.int64))


def grouped(side: Side) -> OrientedSurface:
    """A surface, to look for the closest points on each of its parts."""
    mesh = side.mesh
    component = mesh.component[mesh.triangles[:, 0]]
    return OrientedSurface(side.points, mesh.triangles, mesh.flipped, SHELL_IMAGES.normal_weight, component)


def strays(straightening: float) -> tuple[int, int]:
    """The number of vertices that a noisy map sends to the wrong one of two overlapping parts: before, and after."""
    source, target = side_of(both(sheet(0, 0.55), sheet(0.45, 1.0, NOISE))), side_of(zo.Surface(*sheet(0, 1)))
    points = target.points + NOISE * np.random.default_rng(0).normal(0, 1, target.points.shape) * [0, 0, 1]
    triangle, barycentric = closest_points(points, source.points, source.mesh.triangles)
    corners = source.points[source.mesh.triangles[triangle]]
    distance = np.linalg.norm(np.einsum("nc,ncx->nx", barycentric, corners) - points, axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    every = np.ones(len(points), dtype=bool)
    no_piece, still = np.zeros(0, dtype=np.int64), procrustes(np.zeros((0, 1, 3)), np.zeros((0, 1, 3)))
    motions = PartMotions(target, points, normals, no_piece, no_piece, no_piece, np.zeros(0, dtype=bool), still)
    surface = grouped(source)
    with retune(PART_BORDERS, straightening=straightening):
        changed, onto, weights, apart = straighten_borders(triangle, distance, every, motions, surface, source)
    after = triangle.copy()
    after[changed] = onto
    assert np.allclose(weights.sum(axis=1), 1)
    assert (apart < 5 * NOISE).all()
    component = source.mesh.component[source.mesh.triangles[:, 0]]

    def cut(part: np.ndarray) -> int:
        edges = target.mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        return int((part[edges[:, 0]] != part[edges[:, 1]]).sum())

    return cut(component[triangle]), cut(component[after])


def test_overlapping_parts_meet_in_a_short_border() -> None:
    before, after = strays(PART_BORDERS.straightening)
    assert after < 0.6 * before


def test_vertices_keep_the_nearest_part_without_a_border_cost() -> None:
    before, after = strays(1e-6)
    assert after == before


def test_shirt_covers_the_body_below_it() -> None:
    surface = both(sheet(0, 1), sheet(0.3, 0.7, 0.01))
    side = side_of(surface)
    covered = find_covered(side, np.ones(len(side.points), dtype=bool))[side.mesh.vertex_of]
    x, is_body = surface.vertices[:, 0], surface.vertices[:, 2] == 0
    assert not covered[~is_body].any()
    assert covered[is_body & (np.abs(x - 0.5) < 0.19)].all()
    assert not covered[is_body & (np.abs(x - 0.5) > 0.22)].any()


def images_below_a_shirt(cover: float) -> np.ndarray:
    """The parts that vertices of a body map to, which are below a shirt: 0 for the body, 1 for the shirt."""
    side = side_of(both(sheet(0, 1), sheet(0.3, 0.7, 0.005)))
    component = side.mesh.component[side.mesh.triangles[:, 0]]
    points = np.stack([np.linspace(0.35, 0.65, 20), np.full(20, 0.5), np.full(20, 0.001)], axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (20, 1))
    below = np.flatnonzero(component == component[0])
    triangle, barycentric = closest_points(points, side.points, side.mesh.triangles[below])
    image = Image(below[triangle], barycentric, np.full(20, 0.001))
    every = np.ones(20, dtype=bool)
    visible = ~find_covered(side, np.ones(len(side.points), dtype=bool))
    with retune(SHELL_IMAGES, cover=cover):
        uncover(image, points, normals, side, visible, every)
    return component[image.triangle] != component[0]


def test_images_below_a_shirt_are_moved_onto_it() -> None:
    assert images_below_a_shirt(SHELL_IMAGES.cover).all()
    assert not images_below_a_shirt(0.0).any()
