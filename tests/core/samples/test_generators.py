# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts that generators share: hulls, grids, arcs and implicit bodies."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.arrays import Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.samples.arcs import bend_along_arc
from zoomout_core.samples.grids import grid, grid_faces, ring_faces, triangles_of
from zoomout_core.samples.implicit import Ellipsoid, Limb, Solid, both_sides, bounds, distance, surface_net
from zoomout_core.samples.skeletons import BoneRow, chain_of_bones
from zoomout_core.samples.spheres import ball, directions, outward_hull


def volume(surface: Surface) -> float:
    """Signed volume, positive if faces are wound outwards."""
    a, b, c = surface.vertices[surface.triangles].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def euler_characteristic(faces: Integers) -> int:
    triangles = triangles_of(faces)
    return len(np.unique(triangles)) - len(unique_edges(triangles)[0]) + len(triangles)


def test_a_ball_is_an_ellipsoid_around_its_centre_wound_outwards() -> None:
    egg = ball(2.0, (5, 0, 0), radii=(1, 0.5, 0.5), count=2000)
    assert volume(egg.with_vertices(egg.vertices - [5, 0, 0])) == pytest.approx(4 / 3 * np.pi * 2, rel=0.01)
    np.testing.assert_allclose(np.linalg.norm((egg.vertices - [5, 0, 0]) / [2, 1, 1], axis=1), 1)


def test_a_hull_is_wound_outwards() -> None:
    where = directions(500, 3)
    a, b, c = where[outward_hull(where)].transpose(1, 0, 2)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a) > 0).all()


def test_grid_faces_up_with_points_in_column_order() -> None:
    flat = grid(np.array([0.0, 1, 3]), np.array([0.0, 2]))
    np.testing.assert_array_equal(flat.vertices[:3], [[0, 0, 0], [0, 2, 0], [1, 0, 0]])
    np.testing.assert_array_equal(grid_faces(2, 1), [[0, 2, 3, 1], [2, 4, 5, 3]])
    assert flat.area == pytest.approx(6)
    np.testing.assert_array_equal(triangles_of(grid_faces(1, 1)), [[0, 2, 3], [0, 3, 1]])


@pytest.mark.parametrize(("closed", "expected"), [((False, False), 1), ((True, False), 0), ((True, True), 0)])
def test_closed_grids_are_tubes_and_tori(closed: tuple[bool, bool], expected: int) -> None:
    faces = grid_faces(5, 4, closed)
    assert len(faces) == 20
    assert euler_characteristic(faces) == expected
    assert len(np.unique(faces)) == (6 - closed[0]) * (5 - closed[1])


def test_rings_are_wound_outwards() -> None:
    angle = np.arange(12) * np.pi / 6
    rings = [np.column_stack([np.cos(angle), np.sin(angle), 0 * angle + z]) for z in (0.0, 1.0, 2.0)]
    points, faces = np.concatenate(rings), ring_faces(3, 12)
    a, b, c = points[triangles_of(faces)].transpose(1, 0, 2)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) * [1, 1, 0]) > 0).all()
    assert len(faces) == 24
    assert len(ring_faces(3, 12, closed=True)) == 36


def test_line_bent_along_an_arc_keeps_its_length() -> None:
    angle = np.linspace(0, 1.2, 400)
    along, across = bend_along_arc(np.full(400, 0.5), angle, 3.0, middle=0.5)
    assert np.hypot(np.diff(along), np.diff(across)).sum() == pytest.approx(3 * 1.2, rel=1e-4)
    np.testing.assert_allclose(np.hypot(along, across - 3.5), 3)
    assert along[0] == 0
    assert (np.diff(across) > 0).all()


def test_surface_net_of_solids_is_closed_and_wound_outwards() -> None:
    arm: list[Solid] = [Limb(((0.2, 0, 0, 0.1), (0.6, 0, 0.2, 0.08)), blend=0.05)]
    solids = [Ellipsoid((0, 0, 0), (0.3, 0.25, 0.4)), *both_sides(arm)]
    space = bounds(solids, 0.2)
    np.testing.assert_allclose(space, [[-0.88, -0.45, -0.6], [0.88, 0.45, 0.6]])
    vertices, faces = surface_net(0.03, solids, space)
    assert np.abs(distance(vertices, solids)).max() < 1e-3
    assert euler_characteristic(faces) == 2
    assert volume(Surface(vertices, faces)) > 4 / 3 * np.pi * 0.03
    inside, outside = distance(np.array([[0.1, 0, 0], [1, 1, 1]]), solids)
    assert inside < 0 < outside


def test_bone_chains_are_parented_and_mirrored() -> None:
    first, second = chain_of_bones("toe", "foot.L", (0, 0, 0), (1, 0, 0), (2, 0, 1), side=".L")
    assert second == BoneRow("toe_2.L", "toe_1.L", (1, 0, 0), (2, 0, 1))
    assert first.mirrored() == BoneRow("toe_1.R", "foot.R", (0, 0, 0), (-1, 0, 0))
    assert BoneRow("hips", None, (0, 0, 0), (0, 0, 1)).mirrored().parent is None
