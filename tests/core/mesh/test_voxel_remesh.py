"""One skin around many shells: closed, outside of them all, and joined where they are close."""

from __future__ import annotations

import numpy as np
from creatures import directions
from scipy.spatial import ConvexHull

from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.mesh.voxel_remesh import surface_nets, voxel_remesh

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
    """Whether every edge is passed as often in one direction as in the other."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ascending = edges[:, 0] < edges[:, 1]
    there = {tuple(edge) for edge in edges[ascending].tolist()}
    return there == {tuple(edge) for edge in edges[~ascending][:, ::-1].tolist()}


def test_surface_nets_draw_a_ball_closed_smooth_and_outwards() -> None:
    grid = np.moveaxis(np.indices((24, 24, 24)), 0, -1) - [11.3, 11.5, 11.8]
    vertices, triangles = surface_nets(8 - np.linalg.norm(grid, axis=3))
    assert np.abs(np.linalg.norm(vertices - [11.3, 11.5, 11.8], axis=1) - 8).max() < 0.1
    assert is_closed(triangles)
    assert 0.95 < volume(vertices, triangles) / (4 / 3 * np.pi * 8**3) < 1


def test_a_skin_lies_on_its_mesh() -> None:
    vertices, triangles = voxel_remesh(*ball((3, 4, 5), 2.0))
    voxel = 4 / 128
    assert np.abs(np.linalg.norm(vertices - [3, 4, 5], axis=1) - 2).max() < 1.5 * voxel
    assert is_closed(triangles)
    assert volume(vertices - [3, 4, 5], triangles) > 0


def test_shells_that_overlap_touch_or_lie_close_become_one_and_what_lies_inside_is_gone() -> None:
    shells = together(ball((0, 0, 0), 1), ball((1.5, 0, 0), 1), ball((3.6, 0, 0), 1), ball((0, 0, 0), 0.4))
    vertices, triangles = voxel_remesh(*shells)
    skin = Surface(vertices, triangles)
    assert skin.components.max() == 0
    assert np.linalg.norm(vertices, axis=1).min() > 0.9
    assert vertices[:, 0].max() > 4.5


def test_a_skin_that_is_drawn_below_parts_what_touches() -> None:
    # Two rods that join at one end and nearly touch, as legs do.
    left, right = (ball((0, 0, 0), 1) for _ in range(2))
    rods = [(points * [0.1, 0.1, 1] + [x, 0, 0], corners) for (points, corners), x in ((left, -0.11), (right, 0.11))]
    legs = together(*rods, (ball((0, 0, 0.9), 0.25)))
    ends = [voxel_remesh(*legs, *how)[0] for how in ((), (192, 0.7))]
    between = [points[(np.abs(points[:, 0]) < 0.004) & (np.abs(points[:, 2]) < 0.3)] for points in ends]
    assert len(between[0]) > 0
    assert len(between[1]) == 0


def test_what_is_far_off_is_left_out() -> None:
    vertices, _ = voxel_remesh(*together(ball((0, 0, 0), 1), ball((4, 0, 0), 0.5)))
    assert vertices[:, 0].max() < 1.1


def test_a_mesh_with_a_hole_is_filled() -> None:
    open_box = np.vstack([SIDES[1:, [0, 1, 2]], SIDES[1:, [0, 2, 3]]])
    hole = 0.3
    lid = np.array([[0, 0, 1, 1], [0, 0, 1 - hole, 1 - hole]])  # y of a lid that leaves a gap
    rim = np.array([[0, lid[1, 0], 0], [0, lid[1, 2], 0], [0, lid[1, 2], 1], [0, lid[1, 0], 1]])
    vertices = np.vstack([BOX, rim])
    triangles = np.vstack([open_box, [[8, 9, 10], [8, 10, 11]]])
    skin = voxel_remesh(vertices, triangles)
    assert volume(*skin) > 0.9
    assert triangle_areas(*skin).sum() < 7


def test_units_and_place_change_nothing_but_the_frame() -> None:
    points, triangles = ball((0, 0, 0), 1, 3)
    here = voxel_remesh(points, triangles)
    there = voxel_remesh(1000 * points + 5000, triangles)
    assert np.allclose(1000 * here[0] + 5000, there[0], atol=1e-6)
    assert (here[1] == there[1]).all()


def test_a_skin_is_smooth_and_not_of_steps() -> None:
    vertices, triangles = voxel_remesh(*ball((0, 0, 0), 1.0), 32)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    outwards = (a + b + c) / np.linalg.norm(a + b + c, axis=1, keepdims=True)
    cosine = np.einsum("mx,mx->m", normals, outwards) / np.linalg.norm(normals, axis=1)
    assert np.quantile(cosine, 0.1) > np.cos(np.radians(20))


def test_the_same_voxels_are_filled_however_many_points_are_looked_at_once(monkeypatch) -> None:
    whole = voxel_remesh(*ball((0, 0, 0), 1.0), 16)
    monkeypatch.setattr("zoomout_core.mesh.voxel_remesh.POINTS", 100)
    for ours, theirs in zip(voxel_remesh(*ball((0, 0, 0), 1.0), 16), whole, strict=True):
        np.testing.assert_array_equal(ours, theirs)
