# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys rotate and scale with the target, and move only vertices that the source's keys move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from face_masks import make_face
from scipy.spatial.transform import Rotation
from transfer_meshes import Sheet, globe, identity, nearest_map, plate, sheet, split_at_faces, torus, true_map, tube

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths, unique_edges
from zoomout_core.transfer import Attribute, Domain, Kind, conform, frames, transfer
from zoomout_core.transfer.frames import Frames
from zoomout_core.transfer.keys import shape_keys

GRID = (120, 80)
TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()


class Match:
    """A match with a given confidence."""

    def __init__(self, surface_map: SurfaceMap, confidence: np.ndarray, has_partner: np.ndarray | None = None) -> None:
        self.surface_map, self.confidence, self.has_partner = surface_map, confidence, has_partner


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(tube, *GRID)


@pytest.fixture(scope="module")
def straight() -> Sheet:
    """Another mesh of the same surface."""
    return sheet(tube, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)


def bend_tube(points: np.ndarray, angle: float = 1.2) -> np.ndarray:
    """Bend points (..., 3) around the z axis along an arc."""
    radius = 4 / angle
    turn = points[..., 2] / radius
    reach = radius - points[..., 0]
    return np.stack([radius - reach * np.cos(turn), points[..., 1], reach * np.sin(turn)], axis=-1)


def with_positions(surface: Surface, vertices: np.ndarray) -> Surface:
    """The same mesh with other vertices."""
    return Surface.from_corners(vertices, surface.corner_vertex, surface.face_start, surface.triangle_corners)


def bump(points: np.ndarray, centre: tuple[float, float, float], radius: float) -> np.ndarray:
    """(n,) one at the centre, falling smoothly to zero at the radius."""
    distance = np.linalg.norm(points - centre, axis=1) / radius
    return np.where(distance < 1, (1 - distance**2) ** 2, 0)


def rotate_by_share(
    points: np.ndarray, share: np.ndarray, axis: tuple[float, float, float], angle: float
) -> np.ndarray:
    """(n, 3) displacements by each point's share of a rotation around the tube's centre."""
    around = points - (0, 0, 2)
    return Rotation.from_rotvec(share[:, None] * angle * np.array(axis)).apply(around) - around


def keys(points: np.ndarray) -> dict[str, np.ndarray]:
    """Offsets (n, 3) of points on the tube for typical sculpted keys."""
    outward = points * (1, 1, 0)
    upper = np.clip((points[:, 2] - 1.5) / 1, 0, 1)
    upper = upper * upper * (3 - 2 * upper)
    here = bump(points, (1, 0, 2), 1.2)[:, None]
    return {
        "bulge": 0.3 * here * outward,
        "slide": here * (0, 0.3, 0.2),
        "inflate": 0.1 * outward,
        "twist": rotate_by_share(points, bump(points * (0, 0, 1), (0, 0, 2), 1.5), (0, 0, 1), 1.0),
        "nod": rotate_by_share(points, upper, (0, 1, 0), 0.7),
    }


def offsets(points: np.ndarray) -> np.ndarray:
    """(n, keys, 3) offsets of all keys."""
    return np.stack(list(keys(points).values()), axis=1)


def dents(points: np.ndarray, centre: tuple[float, float, float]) -> np.ndarray:
    """(n, 2, 3) a dent and a slide around a centre."""
    here = bump(points, centre, 0.9)[:, None, None]
    return np.asarray(here * np.array([[-0.2, 0.1, 0], [0.1, 0.1, 0.3]]))


def transfer_keys(values: np.ndarray, match: object, source: Surface, target: Surface) -> Attribute:
    return transfer(Attribute("keys", Domain.POINT, Kind.OFFSET, values), match, source, target)


def errors(values: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(keys,) errors relative to the norm of each key."""
    return np.sqrt(((values - truth) ** 2).sum(axis=(0, 2)) / (truth**2).sum(axis=(0, 2)))


def test_keys_rotate_and_scale_with_the_target(source: Sheet, straight: Sheet) -> None:
    target = with_positions(straight.surface, 2.5 * straight.surface.vertices @ TURN.T + (3, 0, -7))
    surface_map = true_map(source, *GRID, straight.parameters)
    values = offsets(source.surface.vertices)
    expected = 2.5 * surface_map.interpolate(values) @ TURN.T
    assert errors(transfer_keys(values, surface_map, source.surface, target).values, expected).max() < 0.02


def test_identity_returns_the_keys(source: Sheet) -> None:
    values = offsets(source.surface.vertices)
    result = transfer_keys(values, identity(source.surface), source.surface, source.surface)
    assert errors(result.values, values).max() < 1e-3
    assert result.notes == ()


def test_keys_follow_a_bent_target_unlike_plain_offsets(source: Sheet, straight: Sheet) -> None:
    points = straight.surface.vertices
    target = with_positions(straight.surface, bend_tube(points) @ TURN.T)
    surface_map = true_map(source, *GRID, straight.parameters)
    values = offsets(source.surface.vertices)
    # The key moves the straight tube, then the tube is bent.
    truth = (bend_tube(points[:, None] + offsets(points)) - bend_tube(points)[:, None]) @ TURN.T
    result = errors(transfer_keys(values, surface_map, source.surface, target).values, truth)
    plain = errors(surface_map.interpolate(values), truth)
    assert result.max() < 0.25
    assert result.mean() < plain.mean() / 5


def test_vertices_that_no_key_moves_stay_exactly_in_place(source: Sheet, straight: Sheet) -> None:
    target = with_positions(straight.surface, bend_tube(straight.surface.vertices))
    surface_map = true_map(source, *GRID, straight.parameters)
    values = offsets(source.surface.vertices)
    noise = np.random.default_rng(0).normal(scale=1e-6, size=values.shape)
    for given in (values, values + noise):
        result = transfer_keys(given, surface_map, source.surface, target).values
        still = surface_map.interpolate(np.abs(values).max(axis=2) > 1e-9) == 0
        assert still[:, :2].mean() > 0.8
        assert (result[still] == 0).all()


def test_motion_has_no_step_at_its_border(source: Sheet, straight: Sheet) -> None:
    target = with_positions(straight.surface, bend_tube(straight.surface.vertices))
    surface_map = true_map(source, *GRID, straight.parameters)
    values = keys(source.surface.vertices)["bulge"][:, None]
    length = np.linalg.norm(transfer_keys(values, surface_map, source.surface, target).values, axis=2)[:, 0]
    triangles = target.triangles
    border = (length[triangles] > 0).any(axis=1) & (length[triangles] == 0).any(axis=1)
    assert border.any()
    assert length[triangles[border]].max() < 0.03 * length.max()


def test_parts_without_an_anchor_do_not_drift(source: Sheet, straight: Sheet) -> None:
    # A key moves one of two tubes as a whole; the target is placed elsewhere.
    one, other = source.surface, straight.surface
    aside = np.array([9, 0, 0])
    both = Surface(np.concatenate([one.vertices, one.vertices + aside]), _twice(one))
    target = Surface(np.concatenate([other.vertices, other.vertices + aside]) @ TURN.T, _twice(other))
    first = true_map(source, *GRID, straight.parameters)
    surface_map = SurfaceMap(
        np.concatenate([first.triangle, first.triangle + len(one.triangles)]),
        np.concatenate([first.barycentric, first.barycentric]),
        both.triangles,
    )
    values = np.zeros((2 * len(one.vertices), 1, 3))
    values[len(one.vertices) :] = 0.2, 0.5, -0.1
    result = transfer_keys(values, surface_map, both, target).values[:, 0]
    half = len(other.vertices)
    assert (result[:half] == 0).all()
    np.testing.assert_allclose(result[half:], np.broadcast_to(TURN @ (0.2, 0.5, -0.1), (half, 3)), atol=0.01)


def _twice(surface: Surface) -> list[list[int]]:
    faces = np.split(surface.corner_vertex, surface.face_start[1:-1])
    return [face.tolist() for face in [*faces, *(face + len(surface.vertices) for face in faces)]]


@pytest.mark.parametrize("low", [0, 0.0001, 0.001, 0.01])
def test_keys_of_doubtful_vertices_follow_their_surroundings(low: float, source: Sheet, straight: Sheet) -> None:
    points = straight.surface.vertices
    target = with_positions(straight.surface, points @ TURN.T)
    surface_map = true_map(source, *GRID, straight.parameters)
    values = offsets(source.surface.vertices)
    truth = surface_map.interpolate(values) @ TURN.T
    confidence = np.ones(len(points))
    wrong = bump(points, (1, 0, 2.3), 0.4) > 0
    confidence[wrong] = low
    triangle = surface_map.triangle.copy()
    triangle[wrong] = np.random.default_rng(0).permutation(len(source.surface.triangles))[: wrong.sum()]
    torn = SurfaceMap(triangle, surface_map.barycentric, source.surface.triangles)
    result = transfer_keys(values, Match(torn, confidence), source.surface, target)
    blind = transfer_keys(values, torn, source.surface, target)
    assert errors(result.values[wrong], truth[wrong]).max() < 0.35
    assert errors(result.values[wrong], truth[wrong]).mean() < errors(blind.values[wrong], truth[wrong]).mean() / 3
    assert errors(result.values[~wrong], truth[~wrong]).max() < 0.05
    (note,) = result.notes
    assert str(wrong.sum()) in note


@pytest.mark.parametrize("low", [0.0001, 0.001, 0.01])
def test_keys_do_not_follow_a_smooth_map_to_another_place_at_low_confidence(
    low: float, source: Sheet, straight: Sheet
) -> None:
    values = bump(source.surface.vertices, (1, 0, 2.3), 0.8)[:, None, None] * np.array([[0.3, 0, 0.2]])
    right = true_map(source, *GRID, straight.parameters)
    other = true_map(source, *GRID, straight.parameters + np.array([0.5, 0]))  # on the other side of the tube
    truth = right.interpolate(values)
    wrong = bump(straight.surface.vertices, (1, 0, 2.3), 0.4) > 0
    mixed = SurfaceMap(
        np.where(wrong, other.triangle, right.triangle),
        np.where(wrong[:, None], other.barycentric, right.barycentric),
        source.surface.triangles,
    )
    assert errors(mixed.interpolate(values)[wrong], truth[wrong]).mean() > 0.9
    match = Match(mixed, np.where(wrong, low, 1))
    result = transfer_keys(values, match, source.surface, straight.surface).values
    assert errors(result[wrong], truth[wrong]).mean() < 0.4


def test_a_mirrored_target_takes_mirrored_keys() -> None:
    surface, _ = globe(60, 40)
    mirrored = Surface(surface.vertices * (-1, 1, 1), [face[::-1].tolist() for face in _faces(surface)])
    values = dents(surface.vertices, (0.8, 0.6, 0))
    result = transfer_keys(values, identity(surface), surface, mirrored).values
    assert errors(result, values * (-1, 1, 1)).max() < 0.02


def wobbly(source: Sheet, straight: Sheet, size: float) -> SurfaceMap:
    """The true map with smooth random errors of a size."""
    random = np.random.default_rng(0)
    waves, phases = 4 * np.pi * random.standard_normal((3, 40)), random.uniform(0, 2 * np.pi, (2, 40))
    along = [6 * np.cos(straight.surface.vertices @ waves + phase).mean(axis=1) for phase in phases]
    a, b = (straight.parameters + size * np.column_stack(along) / (2 * np.pi, 4)).T
    return true_map(source, *GRID, np.column_stack([a % 1, np.clip(b, 0, 1)]))


def error_on_bent(source: Sheet, straight: Sheet, surface_map: SurfaceMap, angle: float) -> float:
    """The mean error of the keys on the tube bent by an angle."""
    points = straight.surface.vertices
    target = with_positions(straight.surface, bend_tube(points, angle))
    truth = bend_tube(points[:, None] + offsets(points), angle) - bend_tube(points, angle)[:, None]
    values = offsets(source.surface.vertices)
    return float(errors(transfer_keys(values, surface_map, source.surface, target).values, truth).mean())


def test_map_errors_hardly_rotate_keys(source: Sheet, straight: Sheet, monkeypatch: pytest.MonkeyPatch) -> None:
    surface_map = wobbly(source, straight, 0.1)
    steady = error_on_bent(source, straight, surface_map, 1e-6)
    monkeypatch.setattr(Frames, "steady_turns", Frames.turns)
    assert steady < 0.9 * error_on_bent(source, straight, surface_map, 1e-6)


@pytest.mark.parametrize(("angle", "small"), [(8.0, True), (30.0, False)])
def test_only_small_turns_of_similar_shapes_leave_keys_unrotated(
    angle: float, small: bool, source: Sheet, straight: Sheet, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A head whose forehead recedes further looks like one that is rotated; rotated much further, it is.
    turn = Rotation.from_rotvec([np.radians(angle), 0, 0]).as_matrix()
    target = with_positions(straight.surface, straight.surface.vertices @ turn.T)
    surface_map = true_map(source, *GRID, straight.parameters)
    upright = offsets(straight.surface.vertices)

    truth = upright if small else upright @ turn.T

    def error() -> float:
        values = transfer_keys(offsets(source.surface.vertices), surface_map, source.surface, target).values
        return float(errors(values, truth).mean())

    found = error()
    assert found < 0.05
    if small:
        monkeypatch.setattr(frames, "FRAMES", replace(frames.FRAMES, same_direction=1e-3))
        assert error() > 2 * found


def test_features_of_faces_in_one_direction_do_not_rotate_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    # Broader cheeks rotate the neighbourhoods beside the nose.
    face = make_face()
    places, values = face.surface.vertices, np.asarray(face.keys.values)
    cheeks = places + np.column_stack([0 * places[:, :2], 0.25 * np.sin(4 * places[:, 0])])

    def error(angle: float) -> float:
        turn = Rotation.from_rotvec([0, np.radians(angle), 0]).as_matrix()
        target = with_positions(face.surface, cheeks @ turn.T)
        carried = transfer(face.keys, identity(face.surface), face.surface, target).values
        return float(errors(np.asarray(carried), values @ turn.T).mean())

    found, turned = error(1e-6), error(25.0)
    monkeypatch.setattr(shape_keys, "HEAD", 0.1)  # the keys move more than a head
    assert found < 0.9 * error(1e-6)
    assert turned == pytest.approx(error(25.0))  # the direction of a turned head is uncertain


@pytest.mark.parametrize(
    ("number", "value", "size", "angle"), [("excess", 10.0, 0.0, 0.6), ("deviation", 1.0, 0.06, 1.2)]
)
def test_keys_rotate_with_a_bent_target(
    number: str,
    value: float,
    size: float,
    angle: float,
    source: Sheet,
    straight: Sheet,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    surface_map = wobbly(source, straight, size)
    found = error_on_bent(source, straight, surface_map, angle)
    monkeypatch.setattr(frames, "FRAMES", replace(frames.FRAMES, **{number: value}))
    assert found < 0.9 * error_on_bent(source, straight, surface_map, angle)


def test_small_parts_turn_and_grow_like_the_body_beside_them(source: Sheet) -> None:
    lashes = plate(16, 4, width=0.8, height=0.15)
    heads = [
        Surface.joined([source.surface, lashes.with_vertices(size * (lashes.vertices - (0.4, 0, 0)) + (0, 1.05, 2))])
        for size in (1.0, 1.8)
    ]
    values = offsets(heads[0].vertices)
    values[:, :, 2] += 0.1 * heads[0].vertices[:, [0]]
    result = transfer_keys(values, identity(heads[0]), *heads)
    strip = slice(len(source.surface.vertices), None)
    assert errors(result.values[strip], values[strip]).max() < 0.1


@pytest.mark.parametrize(("number", "value"), [("deviation", 100.0), ("smoothing_length", 1e-6)])
def test_lips_swapped_by_the_map_are_hardly_torn(number: str, value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    # Two plates, as close together as lips, part; the map is off by the length of an edge.
    lower = plate(40, 20, width=2.0)
    lips = Surface.joined([lower, lower.with_vertices(lower.vertices + np.array([0, 1.02, 0]))])
    is_upper = lips.vertices[:, 1] > 1.01
    values = np.where(is_upper[:, None, None], 0.25, -0.25) * np.array([0, 1, 0])
    noise = np.random.default_rng(0).normal(scale=0.05, size=lips.vertices.shape) * (1, 1, 0)
    surface_map = nearest_map(lips.vertices + noise, lips)
    edges = unique_edges(lips.triangles)[0]

    def longest() -> float:
        return float(
            edge_lengths(lips.vertices + transfer_keys(values, surface_map, lips, lips).values[:, 0], edges).max()
        )

    found = longest()
    monkeypatch.setattr(shape_keys, "SHAPE_KEYS", replace(shape_keys.SHAPE_KEYS, **{number: value}))
    assert found < 0.8 * longest()


def test_keys_that_cancel_on_the_source_cancel_on_the_target(source: Sheet, straight: Sheet) -> None:
    surface_map = wobbly(source, straight, 0.1)
    first = offsets(source.surface.vertices)[:, :1]
    values = np.concatenate([first, -first], axis=1)
    found = transfer_keys(values, surface_map, source.surface, straight.surface).values
    assert np.abs(found.sum(axis=1)).max() < 1e-12


def test_sheet_of_reversed_winding_takes_the_same_keys() -> None:
    body, lash = globe(30, 20)[0], plate(12, 4, width=0.8, height=0.2)
    lash = lash.with_vertices(lash.vertices + np.array([0, 0, 2]))
    source = Surface.joined([body, lash])
    target = Surface.joined([body, Surface(lash.vertices, lash.triangles[:, ::-1])])
    values = np.zeros((len(source.vertices), 1, 3))
    values[len(body.vertices) :] = 0.1, 0.2, 0.3
    found = transfer_keys(values, identity(source), source, target).values
    assert errors(found, values).max() < 0.02


def _faces(surface: Surface) -> list[np.ndarray]:
    return np.split(surface.corner_vertex, surface.face_start[1:-1])


def test_polygons_loose_vertices_and_split_edges_are_supported(source: Sheet) -> None:
    hexagons = sheet(tube, 60, 40, sides=6)
    surface_map = true_map(source, *GRID, hexagons.parameters)
    values = offsets(source.surface.vertices)
    whole = transfer_keys(values, surface_map, source.surface, hexagons.surface).values
    assert errors(whole, offsets(hexagons.surface.vertices)).max() < 0.05

    split, was = split_at_faces(hexagons.surface)
    split_map = true_map(source, *GRID, hexagons.parameters[was])
    assert np.abs(transfer_keys(values, split_map, source.surface, split).values - whole[was]).max() < 1e-9

    beside = np.array([20, 21, 22])
    more = np.concatenate([hexagons.surface.vertices, hexagons.surface.vertices[beside] + 0.01])
    loose = Surface.from_corners(more, hexagons.surface.corner_vertex, hexagons.surface.face_start)
    ids = np.append(np.arange(len(whole)), beside)
    loose_map = true_map(source, *GRID, hexagons.parameters[ids])
    result = transfer_keys(values, loose_map, source.surface, loose).values
    assert errors(result[-3:], whole[beside]).max() < 0.1


def test_fins_and_degenerate_faces_are_supported(straight: Sheet) -> None:
    source = sheet(torus, 60, 40)
    mesh = sheet(torus, 47, 31, jitter=0.2, sides=3, seed=2)
    points = np.concatenate([mesh.surface.vertices, [[5, 5, 5]]])
    faces = [*_faces(mesh.surface), np.array([0, 1, len(points) - 1]), np.array([0, 1, 1]), np.array([2, 3, 2])]
    target = Surface(points, [face.tolist() for face in faces])
    surface_map = true_map(source, 60, 40, np.concatenate([mesh.parameters, mesh.parameters[:1]]))
    values = dents(source.surface.vertices, (2, 0, 1))
    result = transfer_keys(values, surface_map, source.surface, target).values
    assert np.isfinite(result).all()
    assert errors(result[:-1], dents(mesh.surface.vertices, (2, 0, 1))).max() < 0.3


def test_block_size_does_not_change_results(source: Sheet, straight: Sheet, monkeypatch: pytest.MonkeyPatch) -> None:
    surface_map = true_map(source, *GRID, straight.parameters)
    values = offsets(source.surface.vertices).astype(np.float32)
    together = transfer_keys(values, surface_map, source.surface, straight.surface).values
    monkeypatch.setattr(shape_keys, "KEYS_AT_ONCE", 2)
    apart = transfer_keys(values, surface_map, source.surface, straight.surface).values
    assert together.dtype == np.float32
    np.testing.assert_allclose(apart, together, atol=1e-6)


def test_empty_keys_stay_empty(source: Sheet, straight: Sheet) -> None:
    surface_map = true_map(source, *GRID, straight.parameters)
    values = np.zeros((len(source.parameters), 2, 3))
    assert not transfer_keys(values, surface_map, source.surface, straight.surface).values.any()
    values[:, 0] = offsets(source.surface.vertices)[:, 0]
    result = transfer_keys(values, surface_map, source.surface, straight.surface).values
    assert result[:, 0].any()
    assert not result[:, 1].any()


def test_conforming_moves_the_target_onto_the_source(source: Sheet, straight: Sheet) -> None:
    target = with_positions(straight.surface, 0.5 * bend_tube(straight.surface.vertices) + (8, 0, 0))
    surface_map = true_map(source, *GRID, straight.parameters)
    images = surface_map.interpolate(source.surface.vertices)
    np.testing.assert_allclose(conform(surface_map, source.surface, target), images, atol=1e-9)

    wrong = bump(straight.surface.vertices, (1, 0, 2.3), 0.4) > 0
    triangle = surface_map.triangle.copy()
    triangle[wrong] = 0
    torn = SurfaceMap(triangle, surface_map.barycentric, source.surface.triangles)
    laid = conform(Match(torn, np.where(wrong, 0.0, 1.0)), source.surface, target)
    assert np.linalg.norm(laid - images, axis=1)[wrong].max() < 0.1


@pytest.mark.parametrize(("at_cut", "share"), [(0.005, 0.0), (0.02, 0.5), (0.5, 1.0)])
def test_keys_that_hardly_move_a_cut_do_not_move_what_lies_beyond_it(
    source: Sheet, at_cut: float, share: float
) -> None:
    # The lower half has no partner, as a body below a head.
    height = source.surface.vertices[:, 2]
    upper = np.clip((height - 2) / 2, 0, 1)
    motion = (at_cut + (1 - at_cut) * upper**3)[:, None, None] * np.array([1.0, 0, 0])
    match = Match(identity(source.surface), np.where(height < 2, 0, 1.0), height >= 2)
    moved = transfer_keys(motion, match, source.surface, source.surface)
    np.testing.assert_allclose(moved.values[height < 1.5, 0, 0], share * at_cut, atol=0.05 * share * at_cut)
    np.testing.assert_allclose(moved.values[height > 3, 0], motion[height > 3, 0], atol=0.02)
    assert bool(moved.notes) == bool(share)
