# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of numbers, weights, keys, labels and normals: trust, limits, sums, growth and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation
from transfer_meshes import globe, identity, nearest_map, plate

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas, unique_edges, vertex_normals
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.cut_mesh import cut_surface
from zoomout_core.transfer.frames import DOUBTED_WEIGHT, frames_of, frames_on, on_working_mesh, rotations
from zoomout_core.transfer.inpaint import filling
from zoomout_core.transfer.interpolate import MIX, VOTE
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.normals import LIFTED_SINE, turn_directions, turn_normals
from zoomout_core.transfer.potts import tally
from zoomout_core.transfer.rigging.weights import limit_weights, sum_to_one

MESH = plate(20, 20, jitter=0.1)
X, Y = MESH.vertices[:, 0], MESH.vertices[:, 1]


def point(kind: Kind, values: object) -> Attribute:
    return Attribute("x", Domain.POINT, kind, values)


def match_with_confidence(confidence: np.ndarray, surface: Surface = MESH) -> SimpleNamespace:
    return SimpleNamespace(has_partner=None, surface_map=identity(surface), confidence=confidence)


def side_by_side(*parts: tuple[Surface, tuple[float, float, float], float]) -> tuple[Surface, np.ndarray]:
    """Join plates with given places and sizes; also return (n,) the number of each vertex's part."""
    starts = np.cumsum([0, *(len(part.vertices) for part, _, _ in parts)])
    vertices = np.concatenate([size * part.vertices + np.array(place) for part, place, size in parts])
    faces = [part.corner_vertex.reshape(-1, 4) + start for (part, _, _), start in zip(parts, starts, strict=False)]
    return Surface(vertices, np.concatenate(faces)), np.repeat(np.arange(len(parts)), np.diff(starts))


def mapped_onto(source: Surface, target: Surface, confidence: np.ndarray | float = 1.0) -> MappedTarget:
    """A target whose vertices map to the source vertices of the same numbers."""
    vertices = np.arange(len(target.vertices))
    there = SurfaceMap.from_vertices(vertices, source)
    return MappedTarget(source, target, there, np.broadcast_to(confidence, len(vertices)))


# --- positions of faces and corners-------------------------------------------------------------------------


def test_points_inside_faces_map_between_their_corners() -> None:
    random, mapped = np.random.default_rng(0), mapped_onto(MESH, MESH)
    triangle, barycentric = random.integers(0, len(MESH.triangles), 200), random.dirichlet((1, 1, 1), 200)
    places = np.einsum("qc,qcx->qx", barycentric, MESH.vertices[MESH.triangles[triangle]])
    found = SurfaceMap(*mapped.locate(triangle, barycentric), MESH.triangles).interpolate(MESH.vertices)
    np.testing.assert_allclose(found, places, atol=1e-9)


def test_samples_share_face_areas_and_are_weighted_by_confidence() -> None:
    confidence = np.where(X > 0.5, 0.8, 0.0)
    mapped, faces = mapped_onto(MESH, MESH, confidence), np.array([3, 17, 200, 399])
    samples = mapped.samples(faces)
    np.testing.assert_array_equal(samples.face, np.repeat(faces, 8))  # two triangles with four samples each
    area = np.bincount(MESH.triangle_face, triangle_areas(MESH.vertices, MESH.triangles))[faces]
    np.testing.assert_allclose(np.add.reduceat(samples.area, np.arange(4) * 8), area, rtol=1e-6)
    trust = (samples.weight / samples.area)[[0, -1]]
    assert 0 < trust[0] < 0.01
    assert trust[1] == pytest.approx(0.8, abs=0.01)
    places = np.einsum("qc,qcx->qx", samples.barycentric, MESH.vertices[MESH.triangles[samples.triangle]])
    weighted = np.add.reduceat(samples.area[:, None] * places, np.arange(4) * 8) / area[:, None]
    first = np.isin(MESH.triangle_face, faces)
    middles = MESH.vertices[MESH.triangles[first]].mean(axis=1)
    areas = triangle_areas(MESH.vertices, MESH.triangles[first])
    centres = np.add.reduceat(areas[:, None] * middles, np.arange(4) * 2) / area[:, None]
    np.testing.assert_allclose(weighted, centres, atol=1e-6)


def test_corners_are_nudged_into_their_own_face() -> None:
    mapped = mapped_onto(MESH, MESH)
    corners = np.arange(0, len(MESH.corner_vertex), 7)
    triangle, barycentric = mapped.nudge(corners)
    np.testing.assert_array_equal(MESH.triangle_face[triangle], MESH.corner_face[corners])
    here = SurfaceMap(triangle, barycentric, MESH.triangles).interpolate(MESH.vertices)
    off = np.linalg.norm(here - MESH.vertices[MESH.corner_vertex[corners]], axis=1) * 20
    assert 0.05 < off.min() < off.max() < 0.25  # in widths of a face


def test_bounding_balls_of_faces_touch_the_farthest_corner() -> None:
    mapped = mapped_onto(MESH, MESH)
    middle, radius = mapped.balls
    corners = MESH.vertices[MESH.corner_vertex].reshape(-1, 4, 3)
    np.testing.assert_allclose(middle, corners.mean(axis=1))
    np.testing.assert_allclose(np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1), radius)
    around = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).sum(axis=1)
    np.testing.assert_allclose(mapped.circumference, around)


def test_faces_that_may_cross_a_cut_are_found() -> None:
    middle = MESH.vertices[MESH.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, 0]
    cut = cut_surface(MESH, np.where(middle > 0.5, 1.0, 0.0)[MESH.corner_face][:, None])
    near = mapped_onto(MESH, MESH).near_border(cut)
    inner = (np.abs(MESH.vertices[MESH.corner_vertex].reshape(-1, 4, 3)[:, :, 1] - 0.5).max(axis=1) < 0.4) & (
        np.abs(middle - 0.5) < 0.4
    )
    assert near[np.abs(middle - 0.5) < 0.05].all()
    assert not near[inner & (np.abs(middle - 0.5) > 0.15)].any()
    # A face with corners on two islands crosses the cut, however far its centre is from it.
    coarse = plate(2, 1)
    assert MappedTarget(MESH, coarse, nearest_map(coarse.vertices, MESH), np.ones(6)).near_border(cut).all()
    # One edge of the cut may be as long as all of it.
    cut = cut_surface(coarse, np.repeat([[0.0], [1.0]], 4, axis=0))
    for unit in (1.0, 1000.0):
        source, target = (mesh.with_vertices(unit * mesh.vertices) for mesh in (coarse, MESH))
        cut = cut_surface(source, np.repeat([[0.0], [1.0]], 4, axis=0))
        near = MappedTarget(source, target, nearest_map(target.vertices, source), np.ones(len(X))).near_border(cut)
        assert near[np.abs(middle - 0.5) < 0.035].all()
        assert not near[inner & (np.abs(middle - 0.5) > 0.15)].any()


def test_vertex_labels_are_chosen_by_total_weight() -> None:
    label = np.arange(len(X))
    triangle = np.arange(len(MESH.triangles))
    one, two, three = MESH.triangles.T
    label[two], label[three] = -1, -1
    assert label[one[0]] != -1
    target = plate(1, 1)
    there = SurfaceMap(np.full(4, triangle[0]), np.tile([0.4, 0.3, 0.3], (4, 1)), MESH.triangles)
    mapped = MappedTarget(MESH, target, there, np.ones(4))
    np.testing.assert_array_equal(VOTE[Domain.POINT](point(Kind.LABEL, label), mapped).values, -1)


def test_numbers_keep_their_columns_on_all_domains() -> None:
    mapped = mapped_onto(MESH, MESH)
    for domain, count in ((Domain.POINT, len(X)), (Domain.FACE, 400), (Domain.CORNER, 1600)):
        values = np.random.default_rng(0).random((count, 2, 3)).astype(np.float32)
        found = MIX[domain](Attribute("x", domain, Kind.VECTOR, values), mapped).values
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, values, atol=1e-6)
        pairs = np.random.default_rng(1).integers(0, 2, (count, 2))
        if domain is not Domain.FACE:  # single faces would take the label around them
            found = VOTE[domain](Attribute("x", domain, Kind.LABEL, pairs), mapped).values
            np.testing.assert_array_equal(found, pairs)


def test_faces_keep_their_label_if_borders_are_equally_long() -> None:
    pairs = np.stack(np.divmod(np.arange(400) // 20, 5), axis=1)
    found = VOTE[Domain.FACE](Attribute("x", Domain.FACE, Kind.LABEL, pairs), mapped_onto(MESH, MESH)).values
    np.testing.assert_array_equal(found, pairs)


# --- weights ------------------------------------------------------------------------------------------------


def transfer_weights(table: np.ndarray, **options: object) -> np.ndarray:
    weights = csr_array(table * np.ones((len(X), 1)))
    return transfer(point(Kind.WEIGHT, weights), identity(MESH), MESH, MESH, **options).values.toarray()


@pytest.mark.parametrize(("total", "expected"), [(1.004, 1.0), (0.996, 1.0), (0.97, 0.97), (1.05, 1.05), (0.5, 0.5)])
def test_only_sums_within_rounding_of_one_are_normalized(total: float, expected: float) -> None:
    table = np.array([[0.6, 0.4]]) * total
    np.testing.assert_allclose(transfer_weights(table).sum(axis=1), expected, atol=1e-12)
    assert sum_to_one(csr_array(table)) == (expected == 1)


@pytest.mark.parametrize(("small", "kept"), [(2e-4, True), (5e-5, False)])
def test_negligible_weights_are_dropped(small: float, kept: bool) -> None:
    assert (transfer_weights(np.array([[1 - small, small]]))[:, 1] > 0).all() == kept


def test_weights_fill_the_available_room_unless_negligible() -> None:
    room = np.where(X < 0.3, 5e-5, np.where(X < 0.6, 2e-4, 1.0))
    found = transfer_weights(np.array([[0.5, 0.5]]), room=room).sum(axis=1)
    np.testing.assert_allclose(found, np.where(X < 0.3, 0, room))


def fading(limit: int, groups: int = 3) -> np.ndarray:
    """(n, groups) weights limited per vertex: the first group is everywhere, two others swap ranks in the middle."""
    table = np.column_stack([0 * X + 0.5, np.clip(0.25 + (0.5 - X) / 2, 0, 1), np.clip(0.25 - (0.5 - X) / 2, 0, 1)])
    weights = csr_array(table / table.sum(axis=1, keepdims=True))
    limit_weights(weights, MESH, np.ones(groups, dtype=bool), limit)
    return weights.toarray()


def test_groups_fade_out_before_a_limit_drops_them() -> None:
    full = np.column_stack([0 * X + 0.5, 0.25 + (0.5 - X) / 2, 0.25 - (0.5 - X) / 2])
    found = fading(2)
    assert (np.count_nonzero(found, axis=1) <= 2).all()
    np.testing.assert_allclose(found.sum(axis=1), 1)
    share = found[:, 1] / found[:, 0] / np.maximum(full[:, 1] / full[:, 0], 1e-9)
    column = np.round(20 * X).astype(int)
    by_column = np.array([np.median(share[column == i]) for i in range(20)])
    assert by_column[:7] == pytest.approx(1)  # no fading far from where the group is dropped
    near = by_column[7:10]
    assert (np.diff(by_column[6:11]) < 0).all()
    assert near[0] < 0.9
    assert near[-1] > 0.1
    assert (by_column[12:] == 0).all()


def test_only_shared_groups_are_limited() -> None:
    weights = csr_array(np.tile([0.5, 0.3, 0.2], (len(X), 1)))
    limit_weights(weights, MESH, np.array([True, True, False]), 1)
    np.testing.assert_allclose(weights.toarray(), np.tile([0.8, 0, 0.2], (len(X), 1)))


# --- filling in ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("size", "follows"), [(0.1, True), (0.25, False)])
def test_small_parts_follow_the_nearest_part_and_larger_ones_stay(size: float, follows: bool) -> None:
    surface, part = side_by_side((MESH, (0, 0, 0), 1.0), (plate(4, 4), (1.2, 0.5, 0), size))
    filled = filling(surface, part == 0)
    assert len(filled.follower) == (25 if follows else 0)
    assert filled.left == (0 if follows else 25)
    if follows:
        followed = surface.vertices[filled.followed]
        assert np.ptp(followed, axis=0).max() == 0  # the part moves as a whole
        assert followed[0, 0] == 1


def test_slivers_do_not_spoil_filled_in_values() -> None:
    # Slivers of almost no area among the doubtful vertices.
    vertices = MESH.vertices.copy()
    hole = np.hypot(X - 0.5, Y - 0.5) < 0.2
    inner = np.flatnonzero(hole)
    vertices[inner[3]] = vertices[inner[4]] + 1e-7
    surface = Surface(vertices, MESH.corner_vertex.reshape(-1, 4))
    values = (1 + X + 2 * Y)[:, None]
    found = filling(surface, ~hole).fill(np.where(hole[:, None], 99.0, values))
    assert np.abs(found - (1 + vertices[:, :1] + 2 * vertices[:, 1:2]))[hole].max() < 0.05


def test_linear_values_are_filled_in_linearly_and_within_range() -> None:
    hole = np.hypot(X - 0.5, Y - 0.5) < 0.25
    values = np.column_stack([X, 3 - Y, 0 * X + 7])
    found = filling(MESH, ~hole).fill(np.where(hole[:, None], -5.0, values))
    np.testing.assert_allclose(found, values, atol=0.01)
    known = csr_array(np.column_stack([X, 1 - X]))
    weights = filling(MESH, ~hole).fill_weights(known).toarray()
    np.testing.assert_allclose(weights[hole], np.column_stack([X, 1 - X])[hole], atol=0.01)


def test_untrusted_button_takes_the_weights_of_the_part_below() -> None:
    surface, part = side_by_side((plate(8, 8), (0, 0, 0), 1.0), (plate(2, 2), (0.4, 0.5, 0.05), 0.02))
    weights = csr_array(np.where(part[:, None] == 0, [[0.3, 0.2]], [[0.0, 1.0]]))
    match = match_with_confidence(np.where(part == 0, 1.0, 0.0), surface)
    found = transfer(point(Kind.WEIGHT, weights), match, surface, surface, fill_below=0.5)
    np.testing.assert_allclose(found.values.toarray(), np.tile([0.3, 0.2], (len(part), 1)), atol=1e-6)
    assert "follow the nearest part" in found.notes[0]


def test_part_is_filled_in_from_a_single_trusted_vertex() -> None:
    surface, part = side_by_side((plate(6, 6), (0, 0, 0), 1.0), (plate(4, 4), (2, 0, 0), 1.0))
    known = (part == 0) | (np.cumsum(part == 1) == 8)
    found = filling(surface, known).fill(np.where(known, 3.0 + part, 99.0)[:, None])
    np.testing.assert_allclose(found[:, 0], 3 + part, atol=1e-6)


def test_votes_are_normalized_for_each_face() -> None:
    owner, code = np.array([0, 2, 0, 1, 0, 2]), np.array([5, 3, 4, 4, 5, 3])
    candidates, of = tally(owner, code, np.array([1.0, 2, 6, 5, 2, 8]))
    assert [*zip(candidates.face.tolist(), of.tolist(), strict=True)] == [(0, 4), (0, 5), (1, 4), (2, 3)]
    np.testing.assert_allclose(candidates.share, [6 / 9, 3 / 9, 1, 1])


# --- growth and trust of frames -----------------------------------------------------------------------------


@pytest.mark.parametrize(("grown", "low", "high"), [(2.0, 1.6, 2.4), (40.0, 2.5, 6.5), (1 / 40, 1 / 6.5, 1 / 2.5)])
def test_growth_relative_to_the_whole_is_bounded(grown: float, low: float, high: float) -> None:
    # A small part beside a large one that keeps its size.
    large, small = plate(6, 6), plate(6, 6)
    source, part = side_by_side((large, (0, 0, 0), 100.0), (small, (200, 0, 0), 1.0))
    target, _ = side_by_side((large, (0, 0, 0), 100.0), (small, (200, 0, 0), grown))
    offsets = np.zeros((len(part), 1, 3))
    offsets[part == 1] = [0, 0.1, 0.2]
    there = SurfaceMap.from_vertices(np.arange(len(part)), source)
    found = transfer(point(Kind.OFFSET, offsets), there, source, target).values
    length = np.linalg.norm(found[part == 1, 0], axis=1) / np.linalg.norm(offsets[part == 1, 0], axis=1)
    whole = np.sqrt(target.area / source.area)
    assert low * whole < np.median(length) < high * whole


TURN = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()
# A closed body without symmetry.
GLOBE = globe(16, 10)[0]
BODY = GLOBE.with_vertices(GLOBE.vertices * (1 + 0.3 * GLOBE.vertices[:, [1, 2, 0]]) * [1, 0.7, 1.4])


@pytest.mark.parametrize("mirror", [1, -1])
def test_frames_recover_rotation_reflection_and_growth(mirror: int) -> None:
    linear = 3 * TURN @ np.diag([1, 1, mirror])
    frames = frames_of(mapped_onto(BODY, BODY.with_vertices(BODY.vertices @ linear.T + 5)))
    np.testing.assert_allclose(frames.rotations, np.tile(linear / 3, (len(frames.number), 1, 1)), atol=1e-6)
    np.testing.assert_allclose(frames.turns, np.tile(linear, (len(frames.number), 1, 1)), atol=1e-5)
    np.testing.assert_allclose(frames.areas.sum(), 1)


@pytest.mark.parametrize("spacing", [lambda x: x**2, lambda x: 1 - (1 - x) ** 2])
def test_growth_does_not_depend_on_the_density_of_the_meshes(
    spacing: Callable[[np.ndarray], np.ndarray],
) -> None:
    # The complex exponential maps the plate conformally to a sector of a ring.
    even = plate(20, 20)
    x, y = spacing(even.vertices[:, 0]), even.vertices[:, 1]
    source = even.with_vertices(np.column_stack([x, y, 0 * x]))
    target = even.with_vertices(np.column_stack([np.exp(x) * np.cos(y), np.exp(x) * np.sin(y), 0 * x]))
    growth = np.cbrt(np.linalg.det(frames_of(mapped_onto(source, target)).turns))
    inner = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y)) > 0.2
    np.testing.assert_allclose(growth[inner], np.exp(x)[inner], rtol=0.02)


def test_frames_ignore_untrusted_vertices() -> None:
    x = BODY.vertices[:, 0]
    wrong = x > 0.6 * x.max()
    target = BODY.with_vertices(BODY.vertices @ TURN.T)
    image = np.arange(len(x))
    image[wrong] = np.random.default_rng(0).permutation(np.flatnonzero(wrong))
    mapped = MappedTarget(BODY, target, SurfaceMap.from_vertices(image, BODY), np.where(wrong, 0.0, 1.0))
    trusting = replace(mapped, confidence=np.ones(len(x)))
    off, misled = (np.linalg.norm(frames_of(one).rotations - TURN, axis=(1, 2)) for one in (mapped, trusting))
    assert 4 < wrong.sum() < 40
    assert off.mean() < 0.03
    assert misled[wrong].mean() > 1
    assert misled[~wrong].mean() > 4 * off[~wrong].mean()


def test_doubted_stiffness_covers_only_untrusted_edges() -> None:
    top = BODY.vertices[:, 2] > 0.5
    full, none, half = (
        frames_of(mapped_onto(BODY, BODY, confidence)) for confidence in (1.0, 0.0, np.where(top, 0.0, 1.0))
    )
    np.testing.assert_allclose(full.doubted_stiffness.toarray(), 0, atol=1e-12)
    np.testing.assert_allclose(none.doubted_stiffness.toarray(), DOUBTED_WEIGHT * none.stiffness.toarray(), atol=1e-9)
    edges = ~np.eye(len(top), dtype=bool)
    doubted, expected = half.doubted_stiffness.toarray(), DOUBTED_WEIGHT * half.stiffness.toarray()
    expected[np.ix_(~top, ~top)] = 0
    np.testing.assert_allclose(doubted[edges], expected[edges], atol=1e-8)


def test_mirrored_part_of_a_face_does_not_rotate_with_the_rest() -> None:
    head, part = ball(1, count=600, seed=1), ball(0.7, count=400, seed=2, radii=(1, 0.8, 0.6))
    n, beside = len(head.vertices), np.array([3.0, 0, 0])
    source = Surface(
        np.vstack([head.vertices, part.vertices + beside]), np.vstack([head.triangles, part.triangles + n])
    )
    target = Surface(
        np.vstack([head.vertices, part.vertices * [-1, 1, 1] + beside]),
        np.vstack([head.triangles, part.triangles[:, ::-1] + n]),
    )
    turns = frames_on(mapped_onto(source, target), np.ones(len(source.vertices), dtype=bool), is_face=True).steady_turns
    np.testing.assert_allclose(turns[:n], np.tile(np.eye(3), (n, 1, 1)), atol=0.05)
    np.testing.assert_allclose(turns[n:], np.tile(np.diag([-1.0, 1, 1]), (len(turns) - n, 1, 1)), atol=0.05)


def test_frames_on_vertices_include_their_neighbours() -> None:
    mapped, some = mapped_onto(BODY, BODY), BODY.vertices[:, 2] > 0.5
    edges, _ = unique_edges(BODY.triangles)
    reached = some.copy()
    reached[edges[some[edges].any(axis=1)]] = True
    found = frames_on(mapped, some)
    np.testing.assert_array_equal(found.number, np.flatnonzero(reached))
    np.testing.assert_allclose(found.stiffness.sum(axis=0), 0, atol=1e-9)


def test_faces_corners_and_loose_vertices_take_nearby_rotations() -> None:
    # A rolled-up plate rotates from column to column.
    rolled = MESH.with_vertices(np.column_stack([np.sin(2 * X) / 2, Y, np.cos(2 * X) / 2]))
    above = np.array([[0.25, 0.5, 0.001], [0.75, 0.5, 0.001]])
    beside = np.column_stack([np.sin(2 * above[:, 0]) / 2, above[:, 1], np.cos(2 * above[:, 0]) / 2])
    faces = MESH.corner_vertex.reshape(-1, 4)
    source, target = (
        Surface(np.vstack([surface.vertices, more]), faces) for surface, more in ((MESH, above), (rolled, beside))
    )
    image = np.append(np.arange(len(X)), [0, 0])
    mapped = MappedTarget(source, target, SurfaceMap.from_vertices(image, source), np.ones(len(image)))
    at_points, at_corners, at_faces = (
        rotations(mapped, domain) for domain in (Domain.POINT, Domain.CORNER, Domain.FACE)
    )
    np.testing.assert_array_equal(at_corners, at_points[MESH.corner_vertex])
    around = at_corners.reshape(-1, 4, 3, 3).mean(axis=1)
    assert np.linalg.norm(at_faces - around, axis=(1, 2)).max() < 0.01
    np.testing.assert_allclose(np.linalg.det(at_faces), 1)
    nearest = np.linalg.norm(rolled.vertices - beside[:, None], axis=2).argmin(axis=1)
    np.testing.assert_allclose(at_points[-2:], at_points[nearest])
    angle = np.degrees(Rotation.from_matrix(at_points[: len(X)]).magnitude())
    inner = np.minimum(np.minimum(X, 1 - X), np.minimum(Y, 1 - Y)) > 0.15
    np.testing.assert_allclose(angle[inner], np.degrees(2 * X[inner]), atol=4)


def test_directions_keep_their_length_when_turned() -> None:
    values = np.random.default_rng(0).normal(size=(len(X), 3))
    target = MESH.with_vertices(MESH.vertices @ TURN.T)
    found = turn_directions(point(Kind.DIRECTION, values), mapped_onto(MESH, target)).values
    np.testing.assert_allclose(found, values @ TURN.T, atol=1e-6)


def test_first_of_the_welded_vertices_is_used() -> None:
    # The middle column of vertices is duplicated.
    left, right = plate(2, 2), plate(2, 2)
    vertices = np.vstack([left.vertices, right.vertices + np.array([1, 0, 0]), [[9, 9, 9]]])
    faces = left.corner_vertex.reshape(-1, 4)
    working = Surface(vertices, np.vstack([faces, faces + 9])).working
    assert len(working.vertices) == 15
    found = on_working_mesh(working, np.arange(19))
    np.testing.assert_array_equal(np.sort(found), [*range(9), *range(12, 18)])


@pytest.mark.parametrize("at", [0.5, 0.0])
@pytest.mark.parametrize(("confidence", "followed"), [(1.0, True), (0.6, True), (0.2, False), (0.0, False)])
def test_keys_follow_the_map_if_trusted_and_surroundings_otherwise(
    confidence: float, followed: bool, at: float
) -> None:
    fine = plate(40, 40)
    x, y = fine.vertices[:, 0], fine.vertices[:, 1]
    away = np.hypot(x - at, y - at)
    wrong = away < 0.08
    offsets = np.tile([[[0, 0, 0.1]]], (len(x), 1, 1)).astype(float)
    offsets[wrong] = [0, 0, -0.2]
    match = match_with_confidence(np.where(wrong, confidence, 1.0), fine)
    found = transfer(point(Kind.OFFSET, offsets), match, fine, fine)
    heights = found.values[wrong, 0, 2]
    if followed:
        assert np.median(heights) < -0.1
        assert found.notes == ()
    else:
        assert confidence > 0 or heights.min() > 0.05
        assert f" {wrong.sum():,} doubtful vertices" in found.notes[0]
    np.testing.assert_allclose(found.values[away > 0.25, 0, 2], 0.1, atol=0.01)


def test_fully_untrusted_parts_keep_their_offsets() -> None:
    surface, part = side_by_side((plate(6, 6), (0, 0, 0), 1.0), (plate(6, 6), (2, 0, 0), 1.0))
    offsets = np.tile([[[0, 0, 0.1]]], (len(part), 1, 1))
    found = transfer(
        point(Kind.OFFSET, offsets), match_with_confidence(np.where(part == 0, 1.0, 0.0), surface), surface, surface
    )
    np.testing.assert_allclose(found.values, offsets, atol=1e-3)


@pytest.mark.parametrize(("share", "moves"), [(1e-3, True), (3e-5, False)])
def test_offsets_negligible_against_their_key_are_dropped(share: float, moves: bool) -> None:
    offsets = np.where(X > 0.5, 0.1, 0.1 * share)[:, None, None] * np.array([[[0, 0, 1.0]]])
    found = transfer(point(Kind.OFFSET, offsets), identity(MESH), MESH, MESH).values
    far = X < 0.3
    assert (found[far] != 0).any() == moves


@pytest.mark.parametrize(("length", "moves"), [(1e-5, True), (1e-8, False)])
def test_keys_negligible_against_the_surface_are_dropped(length: float, moves: bool) -> None:
    offsets = np.tile([[[0, 0, length]]], (len(X), 1, 1))
    for scale in (1.0, 1000.0):
        surface = MESH.with_vertices(scale * MESH.vertices)
        found = transfer(point(Kind.OFFSET, scale * offsets), identity(surface), surface, surface).values
        assert found.any() == moves


# --- normals and labels -------------------------------------------------------------------------------------


def test_normals_below_the_surface_are_lifted_just_above_it() -> None:
    # A tilted normal on a source that folds towards it, where the target is flat.
    values = np.tile([0.0, 0, 1.0], (len(X), 1))
    values[X > 0.5] = np.array([0.999, 0, 0.045]) / np.hypot(0.999, 0.045)
    bent = MESH.vertices.copy()
    bent[:, 2] = np.where(X > 0.5, -0.6 * np.sin(6 * (X - 0.5)), 0)
    target = MESH.with_vertices(bent)
    found = transfer(point(Kind.NORMAL, values), identity(MESH), MESH, target).values
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    a, b, c = (target.vertices[target.triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    sums = np.stack([np.bincount(target.triangles.ravel(), np.repeat(axis, 3)) for axis in normal.T], axis=1)
    sums /= np.linalg.norm(sums, axis=1, keepdims=True)
    height = np.einsum("nx,nx->n", found, sums)
    assert height.min() > 0
    # On most of the slope the tilted normal would be below the surface; it is lifted only as far as needed.
    steep = (X > 0.55) & (X < 0.7)
    assert 0.03 < np.median(height[steep]) < 0.08
    assert height[X > 0.55].max() < 0.3


def test_inside_out_surfaces_have_mirrored_normals() -> None:
    values = np.where(X[:, None] > 0.5, [0.999, 0, 0.045], [0.6, 0, 0.8])
    vertices = MESH.vertices.copy()
    vertices[:, 2] = np.where(X > 0.5, -0.6 * np.sin(6 * (X - 0.5)), 0)
    found, mirrored = (
        turn_normals(point(Kind.NORMAL, values), mapped_onto(MESH, Surface(vertices, wound))).values
        for wound in (MESH.triangles, MESH.triangles[:, ::-1])
    )
    up = vertex_normals(vertices, MESH.triangles)
    height = np.einsum("nx,nx->n", found, up)
    # Some normals end below the surface and are lifted before normalisation.
    lifted = np.abs(height - LIFTED_SINE / np.sqrt(1 + LIFTED_SINE**2)) < 1e-4
    assert 3 < lifted.sum() < 0.3 * len(X)
    np.testing.assert_allclose(mirrored, found - 2 * height[:, None] * up, atol=1e-9)


@pytest.mark.parametrize("domain", [Domain.POINT, Domain.CORNER])
def test_normals_are_on_the_side_given_by_the_winding(domain: Domain) -> None:
    tilted = np.array([0.6, 0, 0.8])
    inverted = Surface(MESH.vertices, MESH.corner_vertex.reshape(-1, 4)[:, ::-1])
    values = np.tile(tilted, (len(X) if domain is Domain.POINT else len(MESH.corner_vertex), 1))
    found = transfer(Attribute("x", domain, Kind.NORMAL, values), identity(MESH), MESH, inverted).values
    np.testing.assert_allclose(found, np.broadcast_to(tilted * [1, 1, -1], found.shape), atol=1e-9)
    # Normals that are below the surface on the source stay below.
    sunk = transfer(Attribute("x", domain, Kind.NORMAL, values * [1, 1, -0.1]), identity(MESH), MESH, MESH).values
    assert (sunk[:, 2] < 0).all()


@pytest.mark.parametrize("options", [{"turned": True}, {"turned": False}, {}])
def test_rotations_turn_with_the_surface_on_request(options: dict[str, bool]) -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 1.1])
    target = MESH.with_vertices(turn.apply(MESH.vertices))
    own = Rotation.from_rotvec([0.2, 0.7, -0.1])
    expected = turn * own if options.get("turned") else own
    quaternions = np.tile(np.roll(own.as_quat(), 1), (len(X), 1))
    found = transfer(point(Kind.QUATERNION, quaternions), identity(MESH), MESH, target, **options).values
    off = Rotation.from_quat(np.roll(found, -1, axis=1)) * expected.inv()
    assert off.magnitude().max() < 1e-6
    matrix = np.eye(4)
    matrix[:3, :3] = own.as_matrix() @ np.diag([1, 2, 3])
    matrix[:3, 3] = 4, 5, 6
    result = transfer(point(Kind.MATRIX, np.tile(matrix.ravel(), (len(X), 1))), identity(MESH), MESH, target, **options)
    truth = matrix.copy()
    truth[:3, :3] = expected.as_matrix() @ np.diag([1, 2, 3])
    np.testing.assert_allclose(result.values, np.tile(truth.ravel(), (len(X), 1)), atol=1e-6)


@pytest.mark.parametrize(("size", "kept"), [(0.62, True), (0.4, False)])
def test_islands_survive_if_they_cover_most_of_a_face(size: float, kept: bool) -> None:
    # A labelled square on target faces of width 0.1; no face is mostly inside it.
    source, target = plate(100, 100), plate(10, 10)
    middle = source.vertices[source.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, :2]
    inside = np.abs(middle - 0.5).max(axis=1) < size * 0.05 * np.sqrt(2)
    label = np.where(inside, 7, 1)
    result = transfer(
        Attribute("x", Domain.FACE, Kind.LABEL, label), nearest_map(target.vertices, source), source, target
    )
    assert (result.values == 7).any() == kept


def test_corners_read_labels_on_their_own_side() -> None:
    label = (MESH.vertices[MESH.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, 0] > 0.5).astype(int)
    attribute = Attribute("x", Domain.CORNER, Kind.LABEL, label[MESH.corner_face])
    np.testing.assert_array_equal(transfer(attribute, identity(MESH), MESH, MESH).values, attribute.values)


def test_fading_reduces_steps_between_neighbours() -> None:
    edges, _ = unique_edges(MESH.triangles)
    found = fading(2)
    step = np.abs(found[edges[:, 0]] - found[edges[:, 1]]).sum(axis=1)
    full = np.column_stack([0 * X + 0.5, 0.25 + (0.5 - X) / 2, 0.25 - (0.5 - X) / 2])
    hard = np.where(full >= np.sort(full, axis=1)[:, 1:2], full, 0)
    hard /= hard.sum(axis=1, keepdims=True)
    hard_step = np.abs(hard[edges[:, 0]] - hard[edges[:, 1]]).sum(axis=1)
    assert step.max() < 0.6 * hard_step.max()
