# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigid parts of a source move by themselves where the body's map moves them only roughly."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from test_part_borders import both, grouped, sheet, side_of

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.matching.components.part_borders import straighten_borders
from zoomout_core.matching.components.part_motions import MovedTarget, PartMotions, fit_motions
from zoomout_core.samples.spheres import ball

# The angle by which the second of two ellipsoids turns about the hinge, and the error of the body's map there.
ANGLE, SLIDE = 0.3, 0.025
HINGE = np.array([0.15, 0, 0])


def no_rotations(points: np.ndarray) -> np.ndarray:
    return np.tile(np.eye(3), (len(points), 1, 1))


# The motion of the body, which keeps sizes and sides.
MOTION: Any = SimpleNamespace(scale=1.0, handedness=1.0, rotations=no_rotations)


def ellipsoids() -> zo.Surface:
    """Two ellipsoids that touch."""
    return zo.Surface.joined([ball(0.15, centre, (1, 0.5, 0.35), 1500) for centre in ((0, 0, 0), (0.3, 0, 0))])


def turn(points: np.ndarray, bend: float) -> np.ndarray:
    """Points about the hinge, rotated; with a bend, farther ones turn more."""
    off = points - HINGE
    return np.asarray(Rotation.from_rotvec(np.outer(ANGLE + bend * off[:, 0], [0, 0, 1])).apply(off) + HINGE)


def match_ellipsoids(bend: float = 0.0) -> tuple[PartMotions, Integers, Integers, Integers]:
    """Fit motions to two ellipsoids, the second of which is rotated, by a map that is wrong beside the hinge.

    Returns the motions, and the part of each vertex: the true one, by the map, and by the motions.
    """
    surface = ellipsoids()
    posed = np.where(surface.components[:, None] == 1, turn(surface.vertices, bend), surface.vertices)
    source, target = side_of(surface), side_of(surface.with_vertices(posed))
    slide = SLIDE * np.exp(-(((surface.vertices - HINGE) ** 2).sum(axis=1) / 0.06**2))
    points = surface.vertices - slide[:, None] * [1, 0, 0]
    triangle, _ = closest_points(points, source.points, source.mesh.triangles)
    component, right = source.mesh.component[source.mesh.triangles[:, 0]], source.mesh.component
    every, closest = np.ones(len(points), dtype=bool), grouped(source)
    moved = MovedTarget(points, source.mesh.vertex_normals, MOTION, False)
    motions = fit_motions(component[triangle], moved, every, closest, source, target)
    distance = np.zeros(len(points))
    changed, onto, _, _ = straighten_borders(triangle, distance, every, motions, closest, source)
    after = triangle.copy()
    after[changed] = onto
    return motions, right, component[triangle], component[after]


def test_rotating_part_regains_its_vertices_beside_the_hinge() -> None:
    motions, right, before, after = match_ellipsoids()
    assert motions.rigid.all()
    assert (before != right).sum() > 15
    assert (after != right).sum() < 0.2 * (before != right).sum()


def test_bending_part_has_no_rigid_motion() -> None:
    motions, _, _, _ = match_ellipsoids(bend=5)
    assert motions.rigid[:2].tolist() == [True, False]


def test_pieces_of_a_strongly_bending_part_follow_the_body() -> None:
    motions, right, before, after = match_ellipsoids(bend=40)
    assert motions.rigid.tolist()[:2] == [True, False]
    assert not motions.rigid[2:].any()
    assert (after != right).sum() < (before != right).sum()


def test_pieces_of_a_folding_part_move_rigidly() -> None:
    rest = ball(0.4, (0, 0, 0), (1, 0.3, 0.2), 2000)
    fold = Rotation.from_rotvec([0, 0, 0.8])
    outer = rest.vertices[:, 0] > 0
    source = side_of(rest)
    target = side_of(rest.with_vertices(np.where(outer[:, None], fold.apply(rest.vertices), rest.vertices)))
    inverse = fold.inv().as_matrix()
    turned = np.where(outer[:, None], target.mesh.vertex_normals @ inverse.T, target.mesh.vertex_normals)
    near = cKDTree(target.points)

    def rotations(points: np.ndarray) -> np.ndarray:
        return np.where(outer[near.query(points)[1], None, None], inverse, np.eye(3))

    motion: Any = SimpleNamespace(scale=1.0, handedness=1.0, rotations=rotations)
    points = source.points + [0, SLIDE, 0] * outer[:, None]
    part, every = source.mesh.component, np.ones(len(points), dtype=bool)
    moved = MovedTarget(points, turned, motion, False)
    motions = fit_motions(part, moved, every, grouped(source), source, target)
    away = np.flatnonzero(np.abs(source.points[:, 0]) > 0.1)
    places, _ = motions.transform(away, part[away])
    assert np.linalg.norm(places - source.points[away], axis=1).max() < SLIDE / 2


def test_parts_without_usable_vertices_have_no_rigid_motion() -> None:
    side = side_of(ellipsoids())
    part, none = side.mesh.component, np.zeros(len(side.mesh.component), dtype=bool)
    moved = MovedTarget(side.points, side.mesh.vertex_normals, MOTION, False)
    found = fit_motions(part, moved, none, grouped(side), side, side)
    assert not found.rigid.any()
    points, _ = found.transform(np.arange(len(part)), part)
    np.testing.assert_array_equal(points, side.points)


@pytest.mark.parametrize(("apart", "taken"), [(0.005, False), (0.015, True)])
def test_bending_part_takes_rigid_vertices_only_if_clearly_nearer(apart: float, taken: bool) -> None:
    source, target = side_of(both(sheet(0, 0.55, apart), sheet(0.45, 1.0))), side_of(zo.Surface(*sheet(0, 1)))
    component = source.mesh.component[source.mesh.triangles[:, 0]]
    rigid = component[0]
    triangle = np.empty(len(target.points), dtype=np.int64)
    for part, chosen in (
        (rigid, target.points[:, 0] < 0.55),
        (1 - rigid, target.points[:, 0] >= 0.55),
    ):
        own = np.flatnonzero(component == part)
        triangle[chosen] = own[closest_points(target.points[chosen], source.points, source.mesh.triangles[own])[0]]
    still = procrustes(np.stack([source.points[:50]] * 2), np.stack([source.points[:50]] * 2))
    normals, every = np.tile([0.0, 0.0, 1.0], (len(target.points), 1)), np.ones(len(target.points), dtype=bool)
    pieces, samples = np.array([0, 1]), [np.argmin(np.abs(target.points[:, 0] - x)) for x in (0.25, 0.75)]
    parts = np.array([rigid, 1 - rigid])
    motions = PartMotions(target, target.points, normals, np.array(samples), parts, pieces, pieces == 0, still)
    distance = np.where(component[triangle] == rigid, apart, 0.0)
    changed, onto, _, _ = straighten_borders(triangle, distance, every, motions, grouped(source), source)
    from_rigid = changed[component[triangle[changed]] == rigid]
    assert (len(from_rigid) > 20) == taken
    assert (component[onto] != component[triangle[changed]]).all()
