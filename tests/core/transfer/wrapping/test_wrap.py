# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrap gives the target's mesh the source's shape, on balls with bumps that have an exact solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, triangle_areas, triangle_normals
from zoomout_core.runtime.progress import Cancelled, Progress
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import Wrapped, reverse_match, wrap
from zoomout_core.transfer.wrapping.fit import FIT
from zoomout_core.transfer.wrapping.projections import PROJECTION
from zoomout_core.transfer.wrapping.unfold import UNFOLD, Unfolding
from zoomout_core.tuning import retune

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7])


@dataclass
class Given:
    """The fields of a match that wrap uses."""

    surface_map: SurfaceMap
    confidence: np.ndarray
    has_partner: np.ndarray | None = None
    source_has_partner: np.ndarray | None = None


def bumpy(points: np.ndarray) -> np.ndarray:
    """Map points (n, 3) of the unit sphere to a ball with three bumps."""
    peaks = np.array([[1.0, 0, 0], [-0.6, 0.8, 0], [0, -0.6, 0.8]])
    return points * (1 + 0.35 * (np.maximum(0, points @ peaks.T) ** 8).sum(axis=1))[:, None]


@pytest.fixture(scope="module")
def target() -> Surface:
    return ball(1, count=700, seed=3)


@pytest.fixture(scope="module")
def source() -> Surface:
    fine = ball(1, count=2500, seed=8)
    return fine.with_vertices(3 * TURN.apply(bumpy(fine.vertices)) + [5.0, -2, 9])


def map_directions(points: np.ndarray, source: Surface) -> SurfaceMap:
    """The map of points (n, 3) of the unit sphere to the source points in their directions."""
    back = TURN.inv().apply(source.vertices - [5.0, -2, 9])
    back /= np.linalg.norm(back, axis=1)[:, None]
    unit = points / np.linalg.norm(points, axis=1)[:, None]
    return SurfaceMap(*closest_points(unit, back, source.triangles), source.triangles)


@pytest.fixture(scope="module")
def noisy(target: Surface, source: Surface) -> SurfaceMap:
    """A map with errors of about an edge length, so that many faces fold over."""
    noise = np.random.default_rng(0).normal(0, 0.06, target.vertices.shape)
    return map_directions(target.vertices + noise, source)


@pytest.fixture(scope="module")
def wrapped(noisy: SurfaceMap, source: Surface, target: Surface) -> Wrapped:
    return wrap(noisy, source, target)


def off(points: np.ndarray, source: Surface) -> np.ndarray:
    """(n,) distances from the source, relative to the square root of its area."""
    triangle, barycentric = closest_points(points, source.vertices, source.triangles)
    feet = np.einsum("nc,ncx->nx", barycentric, source.vertices[source.triangles[triangle]])
    return np.linalg.norm(points - feet, axis=1) / np.sqrt(source.area)


def inwards(points: np.ndarray, target: Surface) -> int:
    """Number of triangles of a ball around (5, -2, 9) that face its centre."""
    normals = area_normals(points, target.triangles)
    middles = points[target.triangles].mean(axis=1) - [5.0, -2, 9]
    return int((np.einsum("mx,mx->m", normals, middles) < 0).sum())


def distortion(points: np.ndarray, target: Surface) -> float:
    """Mean change of the angles of triangles, in degrees."""
    angles = []
    for vertices in (points, target.vertices):
        corners = vertices[target.triangles]
        sides = np.roll(corners, -1, axis=1) - corners
        sides /= np.linalg.norm(sides, axis=2, keepdims=True)
        angles.append(np.degrees(np.arccos(np.clip(-(sides * np.roll(sides, 1, axis=1)).sum(axis=2), -1, 1))))
    return float(np.abs(angles[0] - angles[1]).mean())


def shape_error(points: np.ndarray, rest: np.ndarray) -> tuple[float, float]:
    """Greatest distance of points from the best similarity of `rest`, relative to their extent, and its scale."""
    motion = procrustes(rest, points)
    error = np.linalg.norm(motion(rest) - points, axis=1).max()
    return float(error / np.ptp(points, axis=0).max()), float(motion.scale)


def test_a_noisy_map_gives_an_even_mesh_on_the_source(
    wrapped: Wrapped, noisy: SurfaceMap, source: Surface, target: Surface
) -> None:
    images = noisy.interpolate(source.vertices)
    assert inwards(images, target) > 50
    assert inwards(wrapped.vertices, target) == wrapped.turned_over == 0
    assert off(wrapped.vertices, source).max() < 1e-6
    assert distortion(wrapped.vertices, target) < 0.35 * distortion(images, target)
    assert not wrapped.notes


def test_coarse_first_stages_give_the_same_result(
    wrapped: Wrapped, noisy: SurfaceMap, source: Surface, target: Surface
) -> None:
    numbers = np.array([3, 200, 450])
    there = wrapped.vertices[numbers]
    with retune(FIT, coarse_vertices=200):
        found = wrap(noisy, source, target, landmarks=(there, numbers))
    assert found.turned_over == 0
    assert off(found.vertices, source).max() < 1e-3
    apart = np.linalg.norm(found.vertices - wrapped.vertices, axis=1) / np.sqrt(source.area)
    assert 0 < apart.mean() < 0.004
    assert apart[numbers].max() < 1e-9


def test_progress_is_reported_and_a_listener_can_cancel(
    noisy: SurfaceMap, source: Surface, target: Surface, wrapped: Wrapped
) -> None:
    told: list[Progress] = []
    assert np.array_equal(wrap(noisy, source, target, progress=told.append).vertices, wrapped.vertices)
    fractions = [one.fraction for one in told]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0
    assert fractions[-1] > 0.9
    assert len(set(fractions)) > 20
    assert {one.stage for one in told} == {"Wrapping"}

    def listen(latest: Progress) -> None:
        if latest.fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        wrap(noisy, source, target, progress=listen)


def test_vertices_stay_where_the_map_sends_them(source: Surface, target: Surface) -> None:
    found = wrap(map_directions(target.vertices, source), source, target, smoothness=0.2).vertices
    true = 3 * TURN.apply(bumpy(target.vertices)) + [5.0, -2, 9]
    assert np.linalg.norm(found - true, axis=1).mean() < 0.012 * np.sqrt(source.area)


def test_flipped_faces_are_unfolded(noisy: SurfaceMap, source: Surface, target: Surface) -> None:
    with retune(UNFOLD, relaxations=0, retreats=0, releases=1):
        folded = wrap(noisy, source, target, smoothness=0.0)
    assert folded.turned_over > 0
    assert "folded over" in folded.notes[-1]
    assert inwards(folded.vertices, target) > 0
    assert wrap(noisy, source, target, smoothness=0.0).turned_over == 0


def test_unfolding_checks_all_triangles_that_move(
    noisy: SurfaceMap, source: Surface, target: Surface, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = wrap(noisy, source, target, smoothness=0.0)
    every = np.arange(len(target.triangles))
    monkeypatch.setattr(Unfolding, "_triangles_at", lambda self, vertices: every)
    checked = wrap(noisy, source, target, smoothness=0.0)
    np.testing.assert_array_equal(found.vertices, checked.vertices)


def test_nearly_collapsed_faces_are_widened(noisy: SurfaceMap, source: Surface, target: Surface) -> None:
    def narrowest() -> float:
        found = wrap(noisy, source, target, smoothness=0.0).vertices
        return float(
            (triangle_areas(found, target.triangles) / triangle_areas(target.vertices, target.triangles)).min()
        )

    with retune(UNFOLD, min_area=0.0):
        before = narrowest()
    with retune(UNFOLD, min_area=0.05):
        assert narrowest() > 3 * before


def test_smoothness_reduces_distortion(noisy: SurfaceMap, source: Surface, target: Surface, wrapped: Wrapped) -> None:
    rough, even = (wrap(noisy, source, target, smoothness=value).vertices for value in (0.0, 1.0))
    figures = [distortion(points, target) for points in (rough, wrapped.vertices, even)]
    assert figures[0] > 1.2 * figures[1] > 1.2 * figures[2] * 0.99
    assert off(even, source).max() < 1e-6


def test_detail_blends_from_the_coarse_shape_to_the_surface(
    noisy: SurfaceMap, source: Surface, target: Surface, wrapped: Wrapped
) -> None:
    coarse, half = (wrap(noisy, source, target, detail=value).vertices for value in (0.0, 0.5))
    assert off(coarse, source).mean() > 1000 * off(wrapped.vertices, source).mean()
    assert off(coarse, source).mean() > 0.002
    assert np.allclose(half, (coarse + wrapped.vertices) / 2)
    assert inwards(coarse, target) == 0


def test_landmarks_are_met_exactly(noisy: SurfaceMap, source: Surface, target: Surface) -> None:
    numbers = np.array([3, 200, 450])
    away = Rotation.from_rotvec([0, 0, 0.25]).apply(target.vertices[numbers])
    there = map_directions(away, source).interpolate(source.vertices)
    found = wrap(noisy, source, target, landmarks=(there, numbers))
    assert np.abs(found.vertices[numbers] - there).max() < 1e-9
    assert found.turned_over == 0
    assert (off(found.vertices, source) < 0.002).mean() > 0.98
    # Neighbours of a landmark move along instead of leaving a spike.
    around = np.linalg.norm(target.vertices - target.vertices[3], axis=1) < 0.3
    free = wrap(noisy, source, target).vertices
    moved, dragged = there[0] - free[3], (found.vertices - free)[around].mean(axis=0)
    assert dragged @ moved > 0.3 * moved @ moved


def test_landmark_inside_a_face_is_met_exactly(noisy: SurfaceMap, source: Surface, target: Surface) -> None:
    middle = target.vertices[target.triangles[10]].mean(axis=0)
    there = source.vertices[99]
    found = wrap(noisy, source, target, landmarks=([there], [middle])).vertices
    assert np.abs(found[target.triangles[10]].mean(axis=0) - there).max() < 1e-9


def test_parts_without_a_partner_keep_their_shape(source: Surface) -> None:
    plain = ball(1, count=700, seed=3)
    height = 0.8 * np.maximum(0, plain.vertices[:, 2]) ** 40
    horned = plain.with_vertices(plain.vertices * (1 + height)[:, None])
    alone = height > 0.04
    vertex = map_directions(horned.vertices, source)
    match = Given(vertex, np.where(alone, 0.0, 1.0), ~alone)
    found = wrap(match, source, horned)
    error, growth = shape_error(found.vertices[alone], horned.vertices[alone])
    assert error < 0.08
    assert 2.4 < growth < 4
    assert off(found.vertices, source)[~alone].max() < 1e-6
    assert found.notes == (f"{alone.sum()} vertices without a partner, or outside the mask, keep their shape.",)
    # It still points outwards at its old place.
    tip = np.argmax(height)
    base = found.vertices[alone].mean(axis=0)
    up = TURN.apply([0.0, 0, 1])
    assert (found.vertices[tip] - base) @ up > 0.9 * np.linalg.norm(found.vertices[tip] - base)


def test_parts_outside_the_mask_keep_their_shape(source: Surface, target: Surface, noisy: SurfaceMap) -> None:
    mask = (target.vertices[:, 0] > 0).astype(float)
    found = wrap(noisy, source, target, mask=mask)
    outside = target.vertices[:, 0] < -0.15
    error, _ = shape_error(found.vertices[outside], target.vertices[outside])
    whole, _ = shape_error(wrap(noisy, source, target).vertices[outside], target.vertices[outside])
    assert error < 0.07 < whole
    assert off(found.vertices, source)[mask > 0].max() < 1e-6


def test_loose_parts_follow_rigidly(source: Surface, target: Surface, noisy: SurfaceMap) -> None:
    eye = ball(0.05, (0.9, 0, 0), count=40)
    both = Surface.joined([target, eye])
    images = SurfaceMap(
        np.append(noisy.triangle, np.zeros(40, dtype=int)),
        np.concatenate([noisy.barycentric, np.tile([1.0, 0, 0], (40, 1))]),
        source.triangles,
    )
    match = Given(images, np.append(np.ones(700), np.zeros(40)), None)
    found = wrap(match, source, both)
    error, growth = shape_error(found.vertices[700:], eye.vertices)
    assert error < 1e-9
    assert 2 < growth < 6
    middle = TURN.inv().apply(found.vertices[700:].mean(axis=0) - [5.0, -2, 9])
    assert middle[0] > 0.9 * np.linalg.norm(middle)
    assert 2.4 < middle[0] < 4
    assert "Loose parts that follow as rigid pieces: 1." in found.notes


def test_mapped_loose_part_moves_to_its_image_without_spinning(source: Surface, target: Surface) -> None:
    eye, socket = ball(0.05, (0.9, 0, 0), count=40), ball(0.3, (7.0, 1, 8), count=40)
    both, around = Surface.joined([target, eye]), Surface.joined([source, socket])
    body = map_directions(target.vertices, source)
    spun = Rotation.from_rotvec([0, 0, 2.5]).apply(eye.vertices - [0.9, 0, 0]) * 6 + [7.0, 1, 8]
    of_eye = closest_points(spun, socket.vertices, socket.triangles)
    images = SurfaceMap(
        np.append(body.triangle, of_eye[0] + len(source.triangles)),
        np.concatenate([body.barycentric, of_eye[1]]),
        around.triangles,
    )
    found = wrap(images, around, both).vertices[700:]
    assert np.abs(found.mean(axis=0) - [7.0, 1, 8]).max() < 0.02
    assert shape_error(found, eye.vertices)[1] == pytest.approx(6, rel=0.05)
    turn = procrustes(eye.vertices, found).rotation
    assert np.degrees(Rotation.from_matrix(turn.T @ TURN.as_matrix()).magnitude()) < 15


def test_mirrored_target_is_wrapped_and_stays_mirrored(source: Surface) -> None:
    plain = ball(1, count=700, seed=3)
    mirrored = Surface(plain.vertices * [-1, 1, 1], plain.triangles[:, ::-1])
    found = wrap(map_directions(plain.vertices, source), source, mirrored)
    assert found.turned_over == 0
    assert off(found.vertices, source).max() < 1e-6
    assert inwards(found.vertices, mirrored) == len(mirrored.triangles)


def test_units_and_placement_do_not_matter(
    noisy: SurfaceMap, source: Surface, target: Surface, wrapped: Wrapped
) -> None:
    large = target.with_vertices(1000 * target.vertices + 7)
    shrunk = source.with_vertices(0.01 * source.vertices)
    found = wrap(noisy, shrunk, large).vertices
    assert np.abs(100 * found - wrapped.vertices).max() < 1e-5


def test_reversed_match_maps_back(source: Surface, target: Surface) -> None:
    there = map_directions(target.vertices, source)
    back = reverse_match(Given(there, np.full(700, 0.8)), source, target)
    true = TURN.inv().apply(source.vertices - [5.0, -2, 9])
    true /= np.linalg.norm(true, axis=1)[:, None]
    found = back.surface_map.interpolate(target.vertices)
    assert np.linalg.norm(found - true, axis=1).mean() < 0.06
    assert back.confidence == pytest.approx(0.8)
    other = wrap(back, target, source)
    assert off(other.vertices, target).max() < 1e-6
    assert other.turned_over == 0


def test_match_of_a_mirrored_target_is_reversed(source: Surface) -> None:
    plain = ball(1, count=700, seed=3)
    mirrored = Surface(plain.vertices * [-1, 1, 1], plain.triangles[:, ::-1])
    back = reverse_match(map_directions(plain.vertices, source), source, mirrored)
    true = TURN.inv().apply(source.vertices - [5.0, -2, 9]) * [-1, 1, 1]
    true /= np.linalg.norm(true, axis=1)[:, None]
    assert np.linalg.norm(back.surface_map.interpolate(mirrored.vertices) - true, axis=1).mean() < 0.06


def test_unused_vertex_follows_the_mesh(source: Surface, target: Surface, noisy: SurfaceMap) -> None:
    beside = Surface(np.vstack([target.vertices, 1.2 * target.vertices[5]]), target.triangles)
    images = SurfaceMap(
        np.append(noisy.triangle, 0), np.vstack([noisy.barycentric, [1.0, 0, 0]]), noisy.source_triangles
    )
    found = wrap(images, source, beside).vertices
    offset = TURN.inv().apply(found[-1] - found[5])
    assert offset @ target.vertices[5] > 0.8 * np.linalg.norm(offset)
    assert 0.3 < np.linalg.norm(offset) < 1.2


def test_scrambled_patches_of_a_map_are_not_followed(source: Surface, target: Surface) -> None:
    """Where a patch of the map is scrambled, the first stages follow its surroundings."""
    patch = np.flatnonzero(target.vertices[:, 2] > 0.85)
    places = target.vertices.copy()
    places[patch] = places[np.random.default_rng(1).permutation(patch)]
    scrambled = map_directions(places, source)
    true = 3 * TURN.apply(bumpy(target.vertices)) + [5.0, -2, 9]

    def error() -> float:
        found = wrap(scrambled, source, target, smoothness=0.3)
        return float(np.linalg.norm(found.vertices - true, axis=1)[patch].mean())

    trusted = error()
    with retune(FIT, max_growth=100.0, max_stretch=100.0):
        assert trusted < error()


def test_uncovered_parts_of_the_source_attract_the_target(target: Surface) -> None:
    """The source has a horn, and the map stops at its base."""
    fine = ball(1, count=2500, seed=8)
    horn = 1 + np.maximum(0, fine.vertices[:, 0]) ** 30
    source = fine.with_vertices(3 * TURN.apply(fine.vertices * horn[:, None]) + [5.0, -2, 9])
    places = target.vertices.copy()
    near = places[:, 0] > 0.8
    turn = np.arctan2(places[near, 2], places[near, 1])
    places[near] = np.stack([np.full(len(turn), 0.8), 0.6 * np.cos(turn), 0.6 * np.sin(turn)], axis=1)
    bare = map_directions(places, source)

    def reach() -> float:
        found = wrap(bare, source, target).vertices
        return float(off(source.vertices, target.with_vertices(found)).max())

    drawn = reach()
    with retune(PROJECTION, max_points=0):
        assert drawn < 0.5 * reach()


@pytest.mark.parametrize("wrong", [{"smoothness": 1.5}, {"detail": -0.1}, {"mask": [1.0]}, {"mask": np.full(700, 2.0)}])
def test_numbers_out_of_range_are_refused(wrong: dict, noisy: SurfaceMap, source: Surface, target: Surface) -> None:
    with pytest.raises(ValueError, match="0 to 1"):
        wrap(noisy, source, target, **wrong)


def test_empty_masks_and_invalid_landmarks_are_refused(noisy: SurfaceMap, source: Surface, target: Surface) -> None:
    with pytest.raises(MeshError, match="No part of the target"):
        wrap(noisy, source, target, mask=np.zeros(700))
    with pytest.raises(ValueError, match="on each side for every pair"):
        wrap(noisy, source, target, landmarks=([1, 2], [1]))
    with pytest.raises(ValueError, match="Landmarks on the target"):
        wrap(noisy, source, target, landmarks=([1], [[np.nan, 0, 0]]))


def test_normals_of_the_result_agree_with_the_source(wrapped: Wrapped, source: Surface, target: Surface) -> None:
    normals = triangle_normals(wrapped.vertices, target.triangles)
    middles = wrapped.vertices[target.triangles].mean(axis=1)
    triangle, _ = closest_points(middles, source.vertices, source.triangles)
    facing = np.einsum("mx,mx->m", normals, triangle_normals(source.vertices, source.triangles)[triangle])
    assert np.mean(facing > 0.8) > 0.97
