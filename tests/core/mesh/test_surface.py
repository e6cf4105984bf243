# SPDX-License-Identifier: GPL-3.0-or-later
"""Input is checked once, and the working copy is a mesh that geometry can be computed on."""

from __future__ import annotations

import re

import numpy as np
import pytest
from creatures import Creature

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas, triangle_normals

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def reverse_winding(surface: Surface, which: np.ndarray) -> Surface:
    triangles = surface.triangles.copy()
    triangles[which] = triangles[which][:, ::-1]
    return Surface(surface.vertices, triangles)


def signed_volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6)


def test_polygons_of_any_size_are_triangulated_without_folds_or_gaps() -> None:
    star = np.array(
        [[np.cos(t) * r, np.sin(t) * r, 0.3] for t, r in zip(np.arange(10) * np.pi / 5, [2, 0.7] * 5, strict=True)]
    )
    dart = np.array([[0.0, 0, 0], [1, 2, 0], [0, 0.5, 0], [-1, 2, 0]])[:, [2, 0, 1]] + 5
    surface = Surface(np.vstack([SQUARE, star, dart]), [[0, 1, 2, 3], list(range(4, 14)), [14, 15, 16, 17]])
    assert len(surface.triangles) == 2 + 8 + 2
    assert np.array_equal(np.bincount(surface.triangle_face), [2, 8, 2])
    star_area = 0.5 * 10 * 2 * 0.7 * np.sin(np.pi / 5)
    areas = np.bincount(surface.triangle_face, triangle_areas(surface.vertices, surface.triangles))
    np.testing.assert_allclose(areas, [1, star_area, 0.5], rtol=1e-12)
    normals = triangle_normals(surface.vertices, surface.triangles)[surface.triangle_face == 1]
    np.testing.assert_allclose(normals, np.tile([0, 0, 1], (8, 1)), atol=1e-12)


def test_corners_keep_their_faces_and_order() -> None:
    surface = Surface(np.vstack([SQUARE, SQUARE + 2.0]), [[0, 1, 2], [4, 5, 6, 7], [0, 2, 3]])
    assert np.array_equal(surface.corner_face, [0, 0, 0, 1, 1, 1, 1, 2, 2, 2])
    assert np.array_equal(surface.corner_vertex[surface.triangle_corners], surface.triangles)
    assert np.array_equal(
        surface.corner_face[surface.triangle_corners], np.repeat(surface.triangle_face, 3).reshape(-1, 3)
    )


def test_edges_come_from_faces_unless_given() -> None:
    faces = [[0, 1, 2, 3], [0, 4, 1], [2, 1, 4]]
    vertices = np.vstack([SQUARE, [[0.5, 0.5, 1], [3, 3, 3]]])
    surface = Surface(vertices, faces)
    assert {tuple(edge) for edge in surface.edges} == {(0, 1), (1, 2), (2, 3), (0, 3), (0, 4), (1, 4), (2, 4)}
    assert len(surface.edges) == 7
    given = [[4, 2], [5, 0], [1, 0]]
    assert Surface(vertices, faces, given).edges.tolist() == given
    from_corners = Surface.from_corners(vertices, surface.corner_vertex, surface.face_start, edges=given)
    assert from_corners.edges.tolist() == given
    assert from_corners.with_vertices(vertices * 2).edges.tolist() == given
    assert len(Surface(vertices, faces, np.zeros((0, 2), int)).edges) == 0


@pytest.mark.parametrize(
    ("edges", "sentence"),
    [
        ([[0, 4]], "refers to vertex 4"),
        ([[0, -1]], "refers to vertex -1"),
        ([0, 1], "(e, 2)"),
        ([[0, 0.5]], "whole numbers"),
    ],
)
def test_invalid_edges_are_refused(edges: object, sentence: str) -> None:
    with pytest.raises(MeshError, match=re.escape(sentence)):
        Surface(SQUARE, [[0, 1, 2, 3]], edges)


@pytest.mark.parametrize(
    ("vertices", "faces", "sentence"),
    [
        (SQUARE, np.zeros((0, 3), int), "no faces"),
        (SQUARE, [[0, 1, 4]], "refers to vertex 4"),
        (SQUARE, [[0, 1, -1]], "refers to vertex -1"),
        (SQUARE, [[0, 1, 2], [0, 1]], "Face 1 has 2 corners"),
        (np.array([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]]), [[0, 1, 2]], "Vertex 1 has"),
        (SQUARE * [1, 0, 0], [[0, 1, 2]], "no area"),
        (SQUARE[:, :2], [[0, 1, 2]], "(n, 3)"),
        ([["a", "b", "c"]] * 3, [[0, 1, 2]], "must be numbers"),
        ([[0, 0, 0], [1, 0], [0, 1, 0]], [[0, 1, 2]], "three for each vertex"),
        (SQUARE * 1e200, [[0, 1, 2]], "far too large"),
        (SQUARE, np.array([[0.5, 1, 2]]), "whole numbers"),
        (SQUARE, [[0.5, 1, 2]], "whole numbers"),
        (SQUARE, np.array([[0, 1, np.nan]]), "whole numbers"),
        (SQUARE, np.array([[0, 1, np.inf]]), "whole numbers"),
        (SQUARE, [["0", "1", "2"]], "whole numbers"),
        (SQUARE, np.arange(3), "sequence of polygons"),
        (SQUARE, None, "sequence of polygons"),
    ],
)
def test_unusable_meshes_are_refused_in_one_sentence(vertices, faces, sentence: str) -> None:
    with pytest.raises(MeshError) as refusal:
        Surface(vertices, faces)
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_unused_vertices_may_be_nan() -> None:
    surface = Surface(np.vstack([SQUARE, [[np.nan] * 3]]), [[0, 1, 2, 3]])
    assert surface.working.vertex_of[4] == -1
    assert surface.components[4] == -1
    assert np.isfinite(surface.working.vertices).all()


def test_only_coincident_borders_are_welded(resting: Creature) -> None:
    surface = resting.surface
    soup = Surface(surface.vertices[surface.triangles].reshape(-1, 3), np.arange(surface.triangles.size).reshape(-1, 3))
    assert len(soup.working.vertices) == len(surface.vertices)
    assert soup.components.max() == 0
    # Two closed copies share no border, so they stay separate components.
    n = len(surface.vertices)
    beside = surface.vertices + 1e-3 * np.ptp(surface.vertices)
    twice = Surface(np.vstack([surface.vertices, beside]), np.vstack([surface.triangles, surface.triangles + n]))
    assert len(twice.working.vertices) == 2 * n
    assert twice.components.max() == 1


def test_share_of_area_gives_vertices_a_third_of_their_triangles() -> None:
    surface = Surface(SQUARE, [[0, 1, 2, 3]])
    shares = [surface.share_of_area(np.arange(len(SQUARE)) == vertex) for vertex in range(4)]
    assert sorted(shares) == pytest.approx([1 / 6, 1 / 6, 1 / 3, 1 / 3])
    assert surface.share_of_area(np.ones(len(SQUARE), dtype=bool)) == pytest.approx(1)


def test_working_mesh_has_unit_area_at_any_scale_and_place(resting: Creature) -> None:
    moved = Surface(resting.surface.vertices * 1000 + [5e4, 0, -7], resting.surface.triangles)
    working = moved.working
    np.testing.assert_allclose(triangle_areas(working.vertices, working.triangles).sum(), 1, rtol=1e-9)
    np.testing.assert_allclose(working.scale**2, moved.area, rtol=1e-12)


def test_mixed_and_inward_winding_is_oriented_outwards(resting: Creature) -> None:
    surface = resting.surface
    assert not surface.working.flipped.any()
    random = np.random.default_rng(0).random(len(surface.triangles)) < 0.4
    for which in (random, np.ones(len(random), bool)):
        working = reverse_winding(surface, which).working
        assert np.array_equal(working.flipped, which)
        assert signed_volume(working.vertices, working.oriented_triangles) > 0


def test_components_are_numbered_by_area(resting: Creature) -> None:
    surface = resting.surface
    small = surface.vertices * 0.1 + [9, 0, 0]
    both = Surface(np.vstack([small, surface.vertices]), np.vstack([surface.triangles, surface.triangles + len(small)]))
    assert np.array_equal(np.unique(both.components[: len(small)]), [1])
    assert np.array_equal(np.unique(both.components[len(small) :]), [0])
    part, vertices = both.working.part(0)
    assert np.array_equal(vertices, np.arange(len(small), 2 * len(small)))
    np.testing.assert_allclose(triangle_areas(part.vertices, part.triangles).sum(), 1, rtol=1e-9)
    assert np.array_equal(part.vertex_of[len(small) :], np.arange(len(small)))
    assert (part.vertex_of[: len(small)] == -1).all()
    assert np.array_equal(surface.triangles, part.triangles)


def test_degenerate_faces_are_left_out_of_the_working_mesh() -> None:
    surface = Surface(np.vstack([SQUARE, SQUARE[:1]]), [[0, 1, 2], [0, 2, 3], [0, 4, 1]])
    assert len(surface.working.triangles) == 2
    assert np.array_equal(surface.working.triangle_of, [0, 1])


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.float32])
def test_faces_accept_any_numeric_type(dtype: type) -> None:
    surface = Surface(SQUARE.astype(np.float32), np.asfortranarray([[0, 1, 2], [0, 2, 3]], dtype=dtype))
    assert surface.corner_vertex.tolist() == [0, 1, 2, 0, 2, 3]


@pytest.mark.parametrize(
    ("face_start", "triangle_corners", "sentence"),
    [([0, 3], None, "from 0 to 3"), ([1, 4], None, "from 1 to 4"), ([0, 4], [[0, 1, 9]], "corner 9")],
)
def test_inconsistent_corner_arrays_are_refused(face_start, triangle_corners, sentence: str) -> None:
    with pytest.raises(MeshError, match=sentence):
        Surface.from_corners(SQUARE, [0, 1, 2, 3], face_start, triangle_corners)


@pytest.mark.parametrize("normals", [np.ones((5, 3)), np.full((20, 3), np.nan)])
def test_invalid_normals_of_a_point_cloud_are_refused(normals: np.ndarray) -> None:
    with pytest.raises(MeshError, match="20 points"):
        PointCloud(np.random.default_rng(0).normal(size=(20, 3)), normals)


def test_a_tiny_point_cloud_is_refused() -> None:
    with pytest.raises(MeshError, match="at least 12"):
        PointCloud(np.zeros((5, 3)))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("downwards", [False, True])
def test_concave_polygons_facing_any_way_are_triangulated(axis: int, downwards: bool) -> None:
    ring = np.array([[0.0, 0], [4, 0], [4, 3], [2, 1], [0, 3]])  # a notch at the top
    flat = np.insert(ring, axis, 0.7, axis=1)
    order = list(range(5))[:: -1 if downwards else 1]
    surface = Surface(flat, [order])
    areas = triangle_areas(surface.vertices, surface.triangles)
    np.testing.assert_allclose(areas.sum(), 8, rtol=1e-12)
    normals = triangle_normals(surface.vertices, surface.triangles)
    assert (normals[:, axis] == normals[0, axis]).all()


def test_with_vertices_keeps_triangles_and_edge_order() -> None:
    edges = np.array([[2, 3], [1, 0], [3, 0], [1, 2]])
    surface = Surface(SQUARE, [[0, 1, 2, 3]], edges)
    wider = np.array(SQUARE, dtype=float) * (2, 1, 1)
    moved = surface.with_vertices(wider)
    np.testing.assert_array_equal(moved.triangles, surface.triangles)
    np.testing.assert_array_equal(moved.edges, edges)
    np.testing.assert_array_equal(moved.vertices, wider)
    assert moved.area == pytest.approx(2 * surface.area)
    with pytest.raises(MeshError, match="no area"):
        surface.with_vertices(np.zeros((4, 3)))


def test_joined_surfaces_keep_their_order() -> None:
    quad = Surface([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [9, 9, 9]], [[0, 1, 2, 3]], [[0, 4], [0, 1]])
    triangle = Surface([[5, 0, 0], [6, 0, 0], [5, 1, 0]], [[2, 0, 1]])
    both = Surface.joined([quad, triangle, quad])
    assert both.area == pytest.approx(2.5)
    np.testing.assert_array_equal(both.vertices, np.vstack([quad.vertices, triangle.vertices, quad.vertices]))
    np.testing.assert_array_equal(both.face_start, [0, 4, 7, 11])
    np.testing.assert_array_equal(both.corner_vertex, [0, 1, 2, 3, 7, 5, 6, 8, 9, 10, 11])
    np.testing.assert_array_equal(
        both.triangles, np.vstack([quad.triangles, triangle.triangles + 5, quad.triangles + 8])
    )
    np.testing.assert_array_equal(both.edges[[0, 1, -2, -1]], [[0, 4], [0, 1], [8, 12], [8, 9]])


def test_subset_has_the_kept_vertices_and_the_triangles_between_them() -> None:
    strip = Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], [[0, 1, 2], [1, 3, 2], [2, 3, 4]])
    part = strip.subset(np.array([False, True, True, True, False]))
    np.testing.assert_array_equal(part.vertices, strip.vertices[1:4])
    np.testing.assert_array_equal(part.triangles, [[0, 2, 1]])
    with pytest.raises(MeshError):
        strip.subset(np.array([True, True, False, True, False]))


def test_rounding_of_coordinates_is_detected(resting: Creature) -> None:
    far = (resting.surface.vertices + 1e6).astype(np.float32)
    assert resting.surface.with_vertices(far).rounding == 0.0625
    assert resting.surface.with_vertices(far.astype(float) + 0.01).rounding == 2.0**-33
