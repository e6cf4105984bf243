# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxel remeshing puts one closed skin around many shells and bridges small gaps."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from creatures import directions
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.mesh.voxel_remesh import (
    REACH,
    _bridge,
    _distance_to,
    _fill,
    _rasterise,
    _walls_around,
    surface_nets,
    voxel_remesh,
)

BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def ball(centre: tuple[float, float, float], radius: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    where = directions(400, seed)
    return np.array(centre) + radius * where, ConvexHull(where).simplices


def together(*meshes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    first = np.cumsum([0] + [len(points) for points, _ in meshes])
    triangles = [corners + start for (_, corners), start in zip(meshes, first[:-1], strict=True)]
    return np.vstack([points for points, _ in meshes]), np.vstack(triangles)


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def is_closed(triangles: np.ndarray) -> bool:
    """Whether every edge occurs in both directions."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ascending = edges[:, 0] < edges[:, 1]
    there = {tuple(edge) for edge in edges[ascending].tolist()}
    return there == {tuple(edge) for edge in edges[~ascending][:, ::-1].tolist()}


def test_surface_net_of_a_ball_is_closed_smooth_and_outwards() -> None:
    grid = np.moveaxis(np.indices((24, 24, 24)), 0, -1) - [11.3, 11.5, 11.8]
    vertices, triangles = surface_nets(8 - np.linalg.norm(grid, axis=3))
    assert np.abs(np.linalg.norm(vertices - [11.3, 11.5, 11.8], axis=1) - 8).max() < 0.1
    assert is_closed(triangles)
    assert 0.95 < volume(vertices, triangles) / (4 / 3 * np.pi * 8**3) < 1


def test_hull_lies_on_its_mesh() -> None:
    vertices, triangles = voxel_remesh(*ball((3, 4, 5), 2.0), 128)
    voxel = 4 / 128
    assert np.abs(np.linalg.norm(vertices - [3, 4, 5], axis=1) - 2).max() < 1.5 * voxel
    assert is_closed(triangles)
    assert volume(vertices - [3, 4, 5], triangles) > 0


def test_nearby_shells_merge_and_inner_shells_disappear() -> None:
    shells = together(ball((0, 0, 0), 1), ball((1.5, 0, 0), 1), ball((3.6, 0, 0), 1), ball((0, 0, 0), 0.4))
    vertices, triangles = voxel_remesh(*shells, 128)
    skin = Surface(vertices, triangles)
    assert skin.components.max() == 0
    assert np.linalg.norm(vertices, axis=1).min() > 0.9
    assert vertices[:, 0].max() > 4.5


def test_inset_hull_separates_touching_parts() -> None:
    # Two rods that join at one end and nearly touch, like legs.
    left, right = (ball((0, 0, 0), 1) for _ in range(2))
    rods = [(points * [0.1, 0.1, 1] + [x, 0, 0], corners) for (points, corners), x in ((left, -0.11), (right, 0.11))]
    legs = together(*rods, (ball((0, 0, 0.9), 0.25)))
    ends = [voxel_remesh(*legs, *how)[0] for how in ((128,), (192, 0.7))]
    between = [points[(np.abs(points[:, 0]) < 0.004) & (np.abs(points[:, 2]) < 0.3)] for points in ends]
    assert len(between[0]) > 0
    assert len(between[1]) == 0


def test_distant_parts_are_left_out() -> None:
    vertices, _ = voxel_remesh(*together(ball((0, 0, 0), 1), ball((4, 0, 0), 0.5)), 128)
    assert vertices[:, 0].max() < 1.1


def test_a_mesh_with_a_hole_is_filled() -> None:
    open_box = np.vstack([SIDES[1:, [0, 1, 2]], SIDES[1:, [0, 2, 3]]])
    hole = 0.3
    lid = np.array([[0, 0, 1, 1], [0, 0, 1 - hole, 1 - hole]])  # y of a lid with a gap
    rim = np.array([[0, lid[1, 0], 0], [0, lid[1, 2], 0], [0, lid[1, 2], 1], [0, lid[1, 0], 1]])
    vertices = np.vstack([BOX, rim])
    triangles = np.vstack([open_box, [[8, 9, 10], [8, 10, 11]]])
    skin = voxel_remesh(vertices, triangles, 128)
    assert volume(*skin) > 0.9
    assert triangle_areas(*skin).sum() < 7


def test_hull_does_not_depend_on_units_or_placement() -> None:
    points, triangles = ball((0, 0, 0), 1, 3)
    here = voxel_remesh(points, triangles, 128)
    there = voxel_remesh(1000 * points + 5000, triangles, 128)
    assert np.allclose(1000 * here[0] + 5000, there[0], atol=1e-6)
    assert (here[1] == there[1]).all()


def test_hull_has_no_voxel_steps() -> None:
    vertices, triangles = voxel_remesh(*ball((0, 0, 0), 1.0), 32)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    outwards = (a + b + c) / np.linalg.norm(a + b + c, axis=1, keepdims=True)
    cosine = np.einsum("mx,mx->m", normals, outwards) / np.linalg.norm(normals, axis=1)
    assert np.quantile(cosine, 0.1) > np.cos(np.radians(20))


def test_block_size_does_not_change_results(monkeypatch) -> None:
    whole = voxel_remesh(*ball((0, 0, 0), 1.0), 16)
    monkeypatch.setattr("zoomout_core.mesh.voxel_remesh.POINTS", 100)
    for ours, theirs in zip(voxel_remesh(*ball((0, 0, 0), 1.0), 16), whole, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_distances_are_exact_and_clamped() -> None:
    voxels = np.random.default_rng(0).random((30, 31, 32)) < 0.001
    distances = distance_transform_edt(~voxels)
    assert distances.max() > REACH
    np.testing.assert_array_equal(_distance_to(voxels), np.minimum(distances, REACH))


def test_clamping_distances_moves_no_vertex(monkeypatch: pytest.MonkeyPatch) -> None:
    clamped = voxel_remesh(*ball((0, 0, 0), 1.0), 40, 0.7)
    monkeypatch.setattr("zoomout_core.mesh.voxel_remesh._distance_to", lambda voxels: distance_transform_edt(~voxels))
    for ours, theirs in zip(clamped, voxel_remesh(*ball((0, 0, 0), 1.0), 40, 0.7), strict=True):
        np.testing.assert_array_equal(ours, theirs)


# --- voxels ---------------------------------------------------------------------------------------------------------


def block(shape: tuple[int, int, int], *boxes: tuple[tuple[int, int, int], tuple[int, int, int]]) -> np.ndarray:
    """A grid with solid boxes, each from one voxel to another inclusive."""
    grid = np.zeros(shape, dtype=bool)
    for low, high in boxes:
        grid[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))] = True
    return grid


def walls_of_a_box() -> np.ndarray:
    """A hollow box, 9 voxels wide with walls of one voxel, in a grid of 17 per side."""
    box = block((17, 17, 17), ((4, 4, 4), (12, 12, 12)))
    box[5:12, 5:12, 5:12] = False
    return box


def test_triangles_of_all_sizes_are_rasterised_without_gaps() -> None:
    corners = np.array([[2, 2, 3], [14, 2, 3], [2, 14, 3], [15, 15, 9], [15.2, 15, 9], [15, 15.2, 9.0]])
    found = _rasterise(corners, np.array([[0, 1, 2], [3, 4, 5]]), np.array([18, 18, 12]))
    i, j = np.indices((18, 18))
    expected = np.zeros((18, 18, 12), dtype=bool)
    expected[:, :, 3] = (i >= 2) & (j >= 2) & (i + j <= 16)
    expected[15, 15, 9] = True
    sure = np.ones_like(expected)
    sure[:, :, 3] = i + j != 17  # the hypotenuse only touches corners of these voxels
    np.testing.assert_array_equal(found[sure], expected[sure])
    alone = _rasterise(corners[:3], np.array([[0, 1, 2]]), np.array([18, 18, 12]))
    np.testing.assert_array_equal(alone[:, :, 3], found[:, :, 3])


def test_a_triangle_is_rasterised_up_to_its_corners() -> None:
    # Each corner is the only part of the triangle in its voxel.
    corners = np.array([[2.45, 2.45, 3], [13.55, 2.45, 3], [2.45, 13.55, 3]])
    found = _rasterise(corners, np.array([[0, 1, 2]]), np.array([18, 18, 12]))
    assert found[[2, 14, 2], [2, 2, 14], 3].all()


def test_surface_nets_close_solids_next_to_the_grid_border() -> None:
    solid = block((10, 10, 10), ((1, 1, 1), (8, 8, 8)))
    vertices, triangles = surface_nets(np.where(solid, 1.0, -1.0))
    assert is_closed(triangles)
    assert volume(vertices, triangles) == pytest.approx(8**3, rel=0.05)


@pytest.mark.parametrize("resolution", [24, 33])
def test_coarse_hull_is_centred_on_its_mesh(resolution: int) -> None:
    voxel = 4 / resolution
    vertices, _ = voxel_remesh(*ball((3, 4, 5), 2.0), resolution)
    off = np.linalg.norm(vertices - [3, 4, 5], axis=1) - 2
    assert np.abs(off).max() < 1.3 * voxel
    np.testing.assert_allclose((vertices.min(axis=0) + vertices.max(axis=0)) / 2, [3, 4, 5], atol=0.1 * voxel)
    inset, _ = voxel_remesh(*ball((3, 4, 5), 2.0), resolution, 1.0)
    below = np.linalg.norm(vertices - [3, 4, 5], axis=1).mean() - np.linalg.norm(inset - [3, 4, 5], axis=1).mean()
    assert 0.5 * voxel < below < 1.5 * voxel


def test_walls_are_counted_by_direction() -> None:
    count = _walls_around(walls_of_a_box())
    np.testing.assert_array_equal(count[5:12, 5:12, 5:12], 26)
    plane = np.zeros((9, 9, 9), dtype=bool)
    plane[:, :, 2] = True
    assert _walls_around(plane)[4, 4, 4] == 9
    # A single voxel is met in one direction at most.
    assert set(np.unique(_walls_around(block((9, 9, 9), ((4, 4, 4), (4, 4, 4)))))) == {0, 1}


@pytest.mark.parametrize(("holes", "filled"), [(0, True), (2, True), (6, False), (9, False)])
def test_box_is_filled_unless_it_has_too_many_holes(holes: int, filled: bool) -> None:
    box = walls_of_a_box()
    # Open the lid where the nine upward directions from the centre meet it.
    for i, j in list(product((8, 4, 12), repeat=2))[:holes]:
        box[i, j, 12] = False
    assert _fill(box)[8, 8, 8] == filled
    assert _fill(box)[8, 8, 4]
    assert not _fill(box)[8, 8, 14]


def test_closed_solids_are_filled_in_any_rotation() -> None:
    corners = np.vstack([SIDES[:, [0, 1, 2]], SIDES[:, [0, 2, 3]]])
    for turn in Rotation.random(6, random_state=2):
        points = turn.apply(BOX * [24, 16, 12])
        points = points - points.min(axis=0) + 4
        walls = _rasterise(points, corners, np.ceil(points.max(axis=0)).astype(int) + 5)
        assert label(~_fill(walls))[1] == 1


def test_nearby_pieces_are_bridged_where_they_are_closest() -> None:
    near = ((2, 2, 2), (6, 6, 6)), ((10, 4, 4), (14, 8, 8))
    for boxes in (near, near[::-1]):
        joined = _bridge(block((20, 12, 12), *boxes), 5.0)
        assert label(joined)[1] == 1
        assert joined[8, 4:7, 4:7].any()
        assert not joined[8, :4].any()
        assert joined.sum() < 2 * 125 + 60


@pytest.mark.parametrize(("widest", "joined"), [(3.5, True), (2.5, False)])
def test_gaps_are_bridged_up_to_a_width(widest: float, joined: bool) -> None:
    # The gap is three voxels wide.
    found = _bridge(block((20, 12, 12), ((2, 2, 2), (7, 6, 6)), ((11, 2, 2), (14, 6, 6))), widest)
    assert found[13, 4, 4] == joined
    assert found[4, 4, 4]


def test_many_pieces_are_bridged_only_along_the_shortest_gaps() -> None:
    row = [((3 * i + 2, 2, 2), (3 * i + 3, 6, 6)) for i in range(4)]
    found = _bridge(block((20, 12, 12), *row, ((2, 10, 2), (12, 10, 6))), 5.0)
    assert label(found)[1] == 1
    tubes = found.sum() - 4 * 50 - 55
    assert 0 < tubes < 4 * 20


def test_largest_piece_is_kept() -> None:
    one = block((12, 12, 12), ((2, 2, 2), (5, 5, 5)))
    np.testing.assert_array_equal(_bridge(one, 3.0), one)
    touching = one | block((12, 12, 12), ((6, 6, 6), (7, 7, 7)))  # touching at a corner
    np.testing.assert_array_equal(_bridge(touching, 3.0), touching)
    two = one | block((12, 12, 12), ((8, 8, 8), (9, 9, 9)))
    np.testing.assert_array_equal(_bridge(two, 1.5), one)
    np.testing.assert_array_equal(_bridge(two[::-1, ::-1, ::-1], 1.5), one[::-1, ::-1, ::-1])
