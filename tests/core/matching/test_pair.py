# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks and maps from the user are accepted, or rejected with a one-sentence error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.matching.hypotheses.given import given_hypothesis
from zoomout_core.matching.pair import (
    LandmarkError,
    Pair,
    landmark_points,
    landmarks_on_parts,
    positions_of_part,
)
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals

pytestmark = pytest.mark.usefixtures("quick_search")


def shape_of(surface: Surface, proxy_vertices: int | None = None) -> ShapeAnalysis:
    part, _ = surface.working.part(0)
    return analyse(part, k=20, samples=50, seed=0, proxy_vertices=proxy_vertices)


@pytest.fixture(scope="module")
def pair(resting: Creature, bent: Creature) -> Pair:
    """The scaled and moved source, with a small loose part at its end; its proxy has 1,000 vertices."""
    body, eye = resting.surface, creature(80, seed=5).surface
    n = len(body.vertices)
    vertices = np.vstack([body.vertices, 0.05 * eye.vertices + [0, 0, 9]]) * 100 + [500, 0, -3]
    source = Surface(vertices, np.vstack([body.triangles, eye.triangles + n]))
    return Pair(source, bent.surface, shape_of(source, 1000), shape_of(bent.surface), 20, 5)


def test_vertices_and_points_give_the_same_landmarks(pair: Pair) -> None:
    vertices = np.array([0, 100, 2000, 3999])
    by_number = landmarks_on_parts(pair, (vertices, vertices // 2))
    by_place = landmarks_on_parts(pair, (pair.source.vertices[vertices], pair.target.vertices[vertices // 2].tolist()))
    np.testing.assert_array_equal(by_place, by_number)
    assert np.array_equal(by_number[1], vertices // 2)  # the target has no proxy
    stand_in = pair.source_shape.proxy.vertices
    assert len(stand_in) < 1200
    places = pair.source_shape.proxy.full.vertices[vertices]
    distance = np.linalg.norm(stand_in - places[:, None], axis=2)
    assert np.array_equal(by_number[0], distance.argmin(axis=1))


def test_a_point_inside_a_face_goes_to_the_nearest_vertex(pair: Pair) -> None:
    corners = pair.target.triangles[::50]
    inside = np.einsum("c,mcx->mx", [0.2, 0.1, 0.7], pair.target.vertices[corners])
    normals = triangle_normals(pair.target.vertices, corners)
    lifted = inside + 1e-3 * np.sqrt(pair.target.area) * normals  # like a tool that picks points off the surface
    for points in (inside, lifted):
        _, found = landmarks_on_parts(pair, (np.arange(len(points)), points))
        distance = np.linalg.norm(pair.target.vertices - inside[:, None], axis=2)
        np.testing.assert_allclose(distance[np.arange(len(points)), found], distance.min(axis=1), rtol=0.1)


def test_points_on_the_surface_need_only_the_nearest_vertex(pair: Pair, monkeypatch) -> None:
    corners = pair.target.triangles[::500]
    inside = np.einsum("c,mcx->mx", [0.2, 0.1, 0.7], pair.target.vertices[corners]).astype(np.float32).astype(float)
    monkeypatch.delattr(SurfaceSearch, "_groups")
    _, found = landmarks_on_parts(pair, (np.arange(len(inside)), inside))
    np.testing.assert_array_equal(found, corners[:, 2])
    with pytest.raises(AttributeError):
        landmarks_on_parts(pair, (np.arange(len(inside)), inside + 1e-3))


@pytest.mark.parametrize(
    ("landmarks", "sentence"),
    [
        (([0, 1], [2]), "2 source and 1 target"),
        (([0, 4080], [2, 3]), "Landmarks on the source must be vertex numbers from 0 to 4079, but 4080"),
        (([0, 1], [2, -7]), "Landmarks on the target .* -7 is not"),
        (([0.0, 1.5], [2, 3]), "1.5 is not"),
        (([0.0, np.nan], [2, 3]), "nan is not"),
        (([], []), "no landmarks on the source"),
        ((["a"], [2]), "list of vertex numbers"),
        (([[0, 1], [2, 3], [4, 5]], [1, 2, 3]), r"vertex numbers \(m,\) or finite points \(m, 3\).*\(3, 2\)"),
        (([[0, 0, np.nan]], [1]), "finite points"),
        (np.array([[0, 1], [2, 3], [4, 5]]), "two lists"),
        (np.array([[0, 1], [2, 3]]), "two lists"),
        (([0], [1], [2]), "two lists"),
    ],
)
def test_malformed_landmarks_are_refused(pair: Pair, landmarks: object, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as refusal:
        landmarks_on_parts(pair, landmarks)
    assert "\n" not in str(refusal.value)


def test_landmarks_off_the_surface_or_its_main_part_are_refused(pair: Pair) -> None:
    for landmark in ([4000], pair.source.vertices[[0, 4000]]):
        with pytest.raises(MeshError, match=r"on the source, at vertex 40\d\d, is not on its main part"):
            landmarks_on_parts(pair, (landmark, list(range(len(landmark)))))
    off = pair.target.vertices[[7, 8]].copy()
    tip = np.argmax(pair.target.vertices[:, 2])
    off[1] = pair.target.vertices[tip] + [0, 0, 0.06 * np.sqrt(pair.target.area)]
    with pytest.raises(LandmarkError, match=r"Landmark 1 on the target, at .* away from its surface") as error:
        landmarks_on_parts(pair, ([0, 1], off))
    assert (error.value.role, error.value.number) == ("target", 1)  # for callers with other numbering


def test_landmark_at_a_contact_is_on_the_main_part(resting: Creature) -> None:
    """Such as the corner of a lid, where a lash begins."""
    body = resting.surface
    n, unit = len(body.vertices), np.sqrt(body.area)
    tip = int(np.argmax(body.vertices[:, 2]))
    lash = unit * np.array([[0, 0, 1e-4], [0, 0.01, 0.01], [0.01, 0, 0.02]])
    vertices = np.vstack([body.vertices, body.vertices[tip] + lash])
    source = Surface(vertices, np.vstack([body.triangles, [[n, n + 1, n + 2]]]))
    pair = Pair(source, body, shape_of(source), shape_of(body), 20, 5)
    assert len(pair.source_shape.mesh.vertices) == n
    found, _ = landmarks_on_parts(pair, (source.vertices[[n]], [tip]))
    np.testing.assert_array_equal(found, [tip])
    with pytest.raises(LandmarkError, match="is not on its main part"):
        landmarks_on_parts(pair, (source.vertices[[n + 2]], [tip]))


def test_error_names_the_first_unusable_landmark(pair: Pair) -> None:
    with pytest.raises(LandmarkError, match="Landmark 1 on the source, at vertex 4010, is not on") as error:
        landmarks_on_parts(pair, ([7, 4010, 4000, 8], [0, 1, 2, 3]))
    assert error.value.number == 1
    unit, tip = np.sqrt(pair.target.area), np.argmax(pair.target.vertices[:, 2])
    off = pair.target.vertices[tip] + unit * np.array([[0, 0, 0], [0, 0, 0.2], [0, 0, 0.4], [0, 0, 0]])
    with pytest.raises(LandmarkError, match="Landmark 1") as error:
        landmarks_on_parts(pair, (np.arange(4), off))
    assert error.value.number == 1
    assert f"at {off[1].tolist()}, is {0.2 * unit:.3g} away" in error.value.fault
    # A point in a face off the body is reported as the face's first corner.
    face = pair.source.triangles[-1]
    with pytest.raises(LandmarkError, match=f"at vertex {face[0]}, is not on"):
        landmarks_on_parts(pair, (pair.source.vertices[face].mean(axis=0)[None], [0]))


def test_point_near_the_surface_is_accepted_in_any_unit(pair: Pair) -> None:
    tip = np.argmax(pair.source.vertices[:4000, 1])
    beside = pair.source.vertices[tip] + [0, 0.03 * np.sqrt(pair.source.area), 0]
    (by_place, _), (by_number, _) = (landmarks_on_parts(pair, (at, [0])) for at in (beside[None], [tip]))
    np.testing.assert_array_equal(by_place, by_number)


@pytest.fixture(scope="module")
def with_strays() -> tuple[Surface, ShapeAnalysis]:
    """A surface in another unit, whose first and last vertices are unused, and its analysis."""
    made = creature(200).surface
    vertices = 300 * np.vstack([[9.0, 9, 9], made.vertices, [7.0, 7, 7]]) + [1, 20, 3]
    surface = Surface(vertices, made.triangles + 1)
    return surface, shape_of(surface)


def test_positions_of_a_part_equal_those_of_the_surface_exactly(with_strays) -> None:
    surface, shape = with_strays
    np.testing.assert_array_equal(positions_of_part(surface, shape), surface.vertices[1:-1])
    part = shape.proxy.full
    skin = replace(part, vertices=1.1 * part.vertices, is_hull=True)
    around = replace(shape, proxy=replace(shape.proxy, full=skin))
    np.testing.assert_array_equal(positions_of_part(surface, around), skin.to_surface(skin.vertices))


def test_vertices_of_a_shape_refer_to_those_of_the_surface(with_strays, pair: Pair) -> None:
    _, shape = with_strays
    np.testing.assert_array_equal(shape.surface_vertex[:200], np.arange(200) + 1)
    stand_in = pair.source_shape.proxy
    places = stand_in.full.to_surface(stand_in.vertices)
    nearest = cKDTree(pair.source.vertices).query(places)[1]
    np.testing.assert_array_equal(pair.source_shape.surface_vertex, nearest)


def test_landmark_points_of_vertices_and_points_are_equal(pair: Pair) -> None:
    by_number = landmark_points(pair, ([5, 7], [6, 8]))
    by_place = landmark_points(pair, (pair.source.vertices[[5, 7]].tolist(), pair.target.vertices[[6, 8]]))
    for surface, numbers, one, other in zip(
        (pair.source, pair.target), ([5, 7], [6, 8]), by_number, by_place, strict=True
    ):
        np.testing.assert_array_equal(one, surface.vertices[numbers])
        np.testing.assert_array_equal(other, surface.vertices[numbers])


def test_landmark_points_decide_the_side() -> None:
    resting, bent = creature(500), creature(400, seed=1, bend=0.9)
    truth = true_vertex(resting, bent)
    axes = ([1, 0.1, 0.35], [-1, 0.1, 0.35], [0, 1, -0.25])
    tips = np.array([bent.directions @ axis for axis in axes]).argmax(axis=1)
    places = resting.surface.vertices[truth[tips]], bent.surface.vertices[tips]
    result = zo.match(resting.surface, bent.surface, initial="landmarks", landmarks=places, k_final=30)
    by_number = zo.match(resting.surface, bent.surface, initial="landmarks", landmarks=(truth[tips], tips), k_final=30)
    assert np.array_equal(result.surface_map.triangle, by_number.surface_map.triangle)


# --- given maps ---------------------------------------------------------------------------------------------


def wrong_map(name: str, pair: Pair) -> object:
    n = len(pair.target.vertices)
    others = {
        "another source": zo.SurfaceMap(np.zeros(n, int), np.tile([1.0, 0, 0], (n, 1)), pair.source.triangles[::-1]),
        "too few": zo.SurfaceMap(np.zeros(3, int), np.tile([1.0, 0, 0], (3, 1)), pair.source.triangles),
        "number": 5,
        "cube": np.zeros((2, 2, 2)),
        "nan": np.full((4, 4), np.nan),
        "fraction": np.full(n, 1.5),
        "beyond": np.full(n, 4080),
        "large": np.eye(n),
    }
    return others[name]


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("another source", "a different source"),
        ("too few", "for each of 2500 target vertices, not for 3"),
        ("number", "vector or a matrix"),
        ("cube", "vector or a matrix"),
        ("nan", "finite numbers"),
        ("fraction", "1.5 is not"),
        ("beyond", "4080 is not"),
        ("large", "larger than the meshes allow"),
    ],
)
def test_given_maps_that_do_not_fit_are_refused(pair: Pair, name: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as refusal:
        given_hypothesis(pair, wrong_map(name, pair))
    assert "\n" not in str(refusal.value)
