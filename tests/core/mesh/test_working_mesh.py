# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume decides the orientation where there is one; for open sheets it stays undecided."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import directions

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import outward_hull


def cap(lowest: float, inwards: bool = False) -> Surface:
    """The part of a unit ball above a height, wound outwards or inwards."""
    where = directions(800, 0)
    corners = outward_hull(where)[:, :: -1 if inwards else 1]
    return Surface(where, corners[where[corners][:, :, 2].min(axis=1) > lowest])


def outward(surface: Surface) -> float:
    """Share of triangles whose working-mesh orientation points away from the centre of the ball."""
    mesh = surface.working
    corners = mesh.to_surface(mesh.vertices)[mesh.oriented_triangles]
    a, b, c = corners.transpose(1, 0, 2)
    return float((np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0).mean())


@pytest.mark.parametrize("lowest", [-2.0, -0.8, 0.0])
def test_meshes_that_enclose_a_volume_are_oriented_outwards(lowest: float) -> None:
    assert outward(cap(lowest, inwards=True)) == 1
    assert outward(cap(lowest)) == 1


def test_nearly_flat_meshes_keep_their_winding() -> None:
    for inwards in (False, True):
        bowl = cap(0.8, inwards)
        saucer = Surface(bowl.vertices * [1, 1, 0.01], bowl.triangles)
        assert outward(saucer) == (not inwards)


@pytest.mark.parametrize(("lowest", "known"), [(-2.0, True), (-0.9, True), (0.0, False), (0.8, False)])
def test_sides_are_known_for_nearly_closed_meshes(lowest: float, known: bool) -> None:
    assert cap(lowest).working.sides_are_known is known
    assert cap(lowest, inwards=True).working.sides_are_known is known


def test_coincident_borders_are_joined_and_others_are_not() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for gap, parts in ((0.0, 1), (1e-9, 1), (1e-3, 2)):
        both = np.vstack([square, square + np.array([1 + gap, 0, 0])])
        mesh = Surface(both, [[0, 1, 2, 3], [4, 5, 6, 7]]).working
        assert mesh.component.max() + 1 == parts


def test_a_part_keeps_its_place_in_the_surface() -> None:
    near, far = cap(-2.0), cap(-2.0)
    both = Surface.joined([near, Surface(0.5 * far.vertices + [5.0, 0, 0], far.triangles)])
    for number, centre in enumerate(([0, 0, 0], [5, 0, 0])):
        part, _ = both.working.part(number)
        np.testing.assert_allclose(part.to_surface(part.vertices).mean(axis=0), centre, atol=0.01)
        points = np.random.default_rng(0).standard_normal((4, 3))
        np.testing.assert_allclose(part.from_surface(part.to_surface(points)), points)
        a, b, c = part.vertices[part.triangles].transpose(1, 0, 2)
        assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(1)


def test_piece_is_the_largest_connected_part_of_the_vertices() -> None:
    ball = cap(-2.0)
    mesh = ball.working
    inside = (mesh.vertices[:, 2] > 0.1) | (mesh.vertices[:, 2] < -0.2)
    piece, vertices = mesh.piece(inside)
    np.testing.assert_array_equal(vertices, np.flatnonzero(mesh.vertices[:, 2] > 0.1))
    np.testing.assert_allclose(piece.to_surface(piece.vertices), mesh.to_surface(mesh.vertices[vertices]))
    corners = piece.vertices[piece.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(1)
    assert (piece.component == 0).all()
    # A vertex without remaining triangles is dropped.
    alone = inside & (mesh.vertices[:, 2] > 0.1)
    alone[np.argmin(mesh.vertices[:, 2])] = True
    np.testing.assert_array_equal(mesh.piece(alone)[1], vertices)


def test_subdivision_keeps_the_surface_and_lists_old_vertices_first() -> None:
    mesh = cap(0.0, inwards=True).working
    n = len(mesh.vertices)
    finer = mesh.subdivide(n + 1)
    assert mesh.subdivide(n) is mesh
    assert len(finer.triangles) == 4 * len(mesh.triangles)
    np.testing.assert_array_equal(finer.vertices[:n], mesh.vertices)
    np.testing.assert_array_equal(finer.vertex_of, mesh.vertex_of)
    own = mesh.vertex_normals[np.tile(mesh.triangles, (4, 1))].sum(axis=1)
    corners = finer.vertices[finer.oriented_triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("mx,mx->m", normals, own) > 0).all()
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(1)
    twice = mesh.subdivide(len(finer.vertices) + 1)
    assert len(twice.triangles) == 16 * len(mesh.triangles)


def test_sides_are_known_for_each_component() -> None:
    both = Surface.joined([cap(-2.0), Surface(0.5 * cap(0.0).vertices + [5.0, 0, 0], cap(0.0).triangles)])
    assert both.working.component_sides_are_known.tolist() == [True, False]
