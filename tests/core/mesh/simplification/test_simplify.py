# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplified meshes keep borders, seams, charts and topology."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.mirror_pairs import mirror_moves, mirror_pairs
from zoomout_core.mesh.simplification import folds
from zoomout_core.mesh.simplification import simplify as simplification
from zoomout_core.mesh.simplification.collapsing_mesh import KEPT_TRIANGLES, CollapsingMesh
from zoomout_core.mesh.simplification.quadrics import SIMPLIFICATION
from zoomout_core.mesh.simplification.simplify import simplify
from zoomout_core.samples.grids import grid_faces, triangles_of
from zoomout_core.samples.spheres import ball, outward_hull
from zoomout_core.tuning import retune

SIDE = 20


def wavy_grid() -> tuple[np.ndarray, np.ndarray]:
    """A wavy square with its triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, SIDE + 1), np.linspace(0, 1, SIDE + 1), indexing="ij")
    height = 0.1 * np.sin(6 * x) * np.cos(5 * y)
    return np.stack([x, y, height], axis=2).reshape(-1, 3), triangles_of(grid_faces(SIDE, SIDE))


def edges_of(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)


def on_border(points: np.ndarray) -> np.ndarray:
    return ((points[:, :2] < 1e-9) | (points[:, :2] > 1 - 1e-9)).any(axis=1)


def test_result_is_a_manifold_of_the_requested_size_and_border() -> None:
    points, triangles = wavy_grid()
    alive, corners, _ = simplify(points[None], triangles, [], [60])[0]
    made = triangles.ravel()[corners]
    assert abs(len(np.unique(made)) - 60) <= 1
    edges, count = edges_of(made)
    assert count.max() == 2
    assert len(np.unique(made)) - len(edges) + len(made) == 1  # still a disk
    border = np.unique(edges[count == 1])
    assert on_border(points[border]).all()
    assert len(np.unique(alive)) == len(alive)
    corner = {(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)}
    assert corner <= {tuple(row) for row in points[border][:, :2]}


def test_seams_are_kept_and_charts_are_not_flipped() -> None:
    points, triangles = wavy_grid()
    middle = points[triangles].mean(axis=1)
    side = (middle[:, 0] > 0.5).astype(int)  # two charts, with a seam in the middle
    layer = np.repeat(side[:, None], 3, axis=1)
    chart = points[triangles][:, :, :2] * [1, 1] + 2 * side[:, None, None]
    _, corners, _ = simplify(points[None], triangles, [layer], [60], uv=chart)[0]
    made, label = triangles.ravel()[corners], layer.ravel()[corners]
    assert (label == label[:, :1]).all()
    both = np.intersect1d(made[label[:, 0] == 0], made[label[:, 0] == 1])
    np.testing.assert_allclose(points[both, 0], 0.5, atol=1e-9)
    assert len(both) >= 3
    flat = chart.reshape(-1, 2)[corners]
    assert (np.linalg.det(flat[:, 1:] - flat[:, :1]) * np.linalg.det(chart[0, 1:] - chart[0, :1]) > 0).all()


def test_last_layers_are_ignored_if_too_many_vertices_remain() -> None:
    points, triangles = wavy_grid()
    every_face = np.repeat(np.arange(len(triangles))[:, None], 3, axis=1)
    middle = points[triangles].mean(axis=1)
    halves = np.repeat((middle[:, :1] > 0.5).astype(int), 3, axis=1)
    _, corners, _ = simplify(points[None], triangles, [halves, every_face], [60])[0]
    assert abs(len(np.unique(triangles.ravel()[corners])) - 60) <= 1
    label = halves.ravel()[corners]
    assert (label == label[:, :1]).all()


def test_triangles_do_not_mix_charts_if_all_layers_are_ignored() -> None:
    points, triangles = wavy_grid()
    middle = points[triangles].mean(axis=1)
    chart = np.floor(5 * middle[:, :2]).astype(int) @ [5, 1]  # 25 squares, with corners that cannot be removed
    layer = len(points) * chart[:, None] + triangles
    _, corners, content = simplify(points[None], triangles, [layer], [20])[0]
    assert len(np.unique(triangles.ravel()[corners])) <= 21
    of_corner = np.repeat(chart, 3)
    assert (of_corner[content] == of_corner[content][:, :1]).all()
    assert (of_corner[corners] != of_corner[corners][:, :1]).any()


def test_the_most_important_regions_do_not_vanish() -> None:
    points, triangles = wavy_grid()
    regions = np.zeros(len(triangles), dtype=int)
    for number, corner in enumerate(([0.3, 0.3], [0.7, 0.3], [0.3, 0.7], [0.7, 0.7]), 1):
        distance = np.linalg.norm(points[triangles].mean(axis=1)[:, :2] - corner, axis=1)
        regions[np.argsort(distance)[:6]] = number
    layer = np.repeat(regions[:, None], 3, axis=1)
    alive, _, _ = simplify(points[None], triangles, [layer], [24])[0]
    assert len(np.unique(regions[alive])) < 4
    alive, corners, _ = simplify(points[None], triangles, [layer], [24], regions=regions)[0]
    assert len(np.unique(triangles.ravel()[corners])) == 24
    # Three regions are an eighth of the vertices, the first of which is all around the others.
    assert (np.bincount(regions[alive], minlength=5)[:3] >= KEPT_TRIANGLES).all()
    assert len(np.unique(regions[alive])) < 5


@pytest.mark.parametrize("seed", [70, 101])
def test_simultaneous_collapses_leave_enough_of_each_region(seed: int) -> None:
    """Each of these collapses alone would leave enough."""
    points, triangles = wavy_grid()
    places, rng = points[triangles].mean(axis=1)[:, :2], np.random.default_rng(seed)
    regions = np.zeros(len(triangles), dtype=int)
    for number in range(1, 5):
        regions[(np.abs(places - rng.uniform(size=2)) < rng.uniform(0.03, 0.1, 2)).all(axis=1)] = number
    layer = np.repeat(regions[:, None], 3, axis=1)
    alive, _, _ = simplify(points[None], triangles, [layer], [44], regions=regions)[0]
    assert (np.bincount(regions[alive], minlength=5) >= KEPT_TRIANGLES).all()


def test_more_vertices_are_kept_where_poses_bend_the_mesh() -> None:
    points, triangles = wavy_grid()
    points[:, 2] = 0
    bent = points.copy()
    bent[:, 2] = 0.2 * np.cos(40 * points[:, 0]) * (points[:, 0] < 0.3)
    shares = []
    for weight in (0.0, SIMPLIFICATION.poses):
        with retune(SIMPLIFICATION, poses=weight):
            _, corners, _ = simplify(np.array([points, bent]), triangles, [], [100])[0]
        kept = np.unique(triangles.ravel()[corners])
        shares.append((points[kept, 0] < 0.35).mean())
    assert shares[1] > shares[0] + 0.05


def test_borders_keep_their_shape() -> None:
    points, triangles = wavy_grid()
    points[:, 2] = 0
    points[:, 1] += 0.1 * np.sin(7 * points[:, 0])  # flat, with a wavy border
    areas = []
    for weight in (0.0, SIMPLIFICATION.lines):
        with retune(SIMPLIFICATION, lines=weight):
            _, corners, _ = simplify(points[None], triangles, [], [60])[0]
        made = points[triangles.ravel()[corners]]
        areas.append(np.abs(np.linalg.det(made[:, 1:, :2] - made[:, :1, :2])).sum() / 2)
    whole = np.abs(np.linalg.det(points[triangles][:, 1:, :2] - points[triangles][:, :1, :2])).sum() / 2
    assert abs(areas[1] - whole) < 0.5 * abs(areas[0] - whole)


def test_mirror_pairs_are_kept_together() -> None:
    points, triangles = wavy_grid()
    points[:, 2] = 0.1 * np.cos(9 * (points[:, 0] - 0.5)) * np.cos(5 * points[:, 1])
    pairs = mirror_pairs(points)
    assert pairs is not None
    np.testing.assert_allclose(points[pairs], points * [-1, 1, 1] + [1, 0, 0], atol=1e-9)
    _, corners, _ = simplify(points[None], triangles, [], [100], pairs)[0]
    kept = np.unique(triangles.ravel()[corners])
    assert np.isin(pairs[kept], kept).mean() > 0.97
    assert mirror_pairs(np.random.default_rng(0).random((50, 3))) is None
    moved = points + np.random.default_rng(1).normal(size=points.shape)
    even = mirror_moves(points, moved, pairs) - points
    np.testing.assert_allclose(even[pairs], even * [-1, 1, 1], atol=1e-12)


@pytest.mark.parametrize("part", ["mirror_diagonals", "_unpair"])
def test_nearly_symmetric_meshes_are_simplified_accurately(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its quads are divided alike on both sides, and one in ten vertices has no mirror image."""
    points, triangles = wavy_grid()
    points[:, 2] = 0.1 * np.cos(9 * (points[:, 0] - 0.5)) * np.cos(5 * points[:, 1])
    if part == "_unpair":
        moved = np.random.default_rng(0).permutation(len(points))[: len(points) * 6 // 100]
        points[moved, 1] += 0.004 * ~on_border(points[moved])
    pairs = mirror_pairs(points)

    def error() -> float:
        _, corners, _ = simplify(points[None], triangles, [], [100], pairs)[0]
        made = triangles.ravel()[corners]
        triangle, barycentric = closest_points(points, points, made)
        nearest = np.einsum("nk,nkx->nx", barycentric, points[made[triangle]])
        return float(np.linalg.norm(points - nearest, axis=1).mean())

    mended = error()
    monkeypatch.setattr(CollapsingMesh, part, lambda *_: None)
    assert mended < 0.92 * error()


def test_parts_are_not_flattened_to_reach_the_count(monkeypatch: pytest.MonkeyPatch) -> None:
    points, triangles = wavy_grid()

    def height_of_level() -> float:
        _, corners, _ = simplify(points[None], triangles, [], [4])[0]
        return float(np.ptp(points[triangles.ravel()[corners]][..., 2]))

    whole = float(np.ptp(points[:, 2]))
    assert height_of_level() > 0.8 * whole
    monkeypatch.setattr(simplification, "DISTANCES", (9.0, 9.0))
    assert height_of_level() < 0.8 * whole


def test_sides_of_a_thin_part_do_not_merge(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slab beside a larger ball, whose shape dominates the error."""
    lattice = np.stack(np.meshgrid(*[np.linspace(-1, 1, 4)] * 3), axis=-1).reshape(-1, 3)
    cube = lattice[np.abs(lattice).max(axis=1) > 0.99]
    larger = ball(1.0, count=150)
    # No costs are equal, because rounding would decide between them.
    uneven = cube + np.random.default_rng(0).normal(scale=0.05, size=cube.shape)
    points = np.concatenate([uneven * [0.1, 0.02, 0.08] - [0, 1.1, 0], larger.vertices])
    slab = outward_hull(cube / np.linalg.norm(cube, axis=1)[:, None])
    triangles = np.concatenate([slab, larger.triangles + len(cube)])

    def volume_of_slab() -> float:
        _, corners, _ = simplify(points[None], triangles, [], [30])[0]
        made = triangles.ravel()[corners]
        return float(np.linalg.det(points[made[made[:, 0] < len(cube)]]).sum() / np.linalg.det(points[slab]).sum())

    assert volume_of_slab() > 0.3
    monkeypatch.setattr(folds, "MIN_OPENING", 0.0)
    assert volume_of_slab() < 0.05


def test_sheets_with_two_sides_are_simplified(monkeypatch: pytest.MonkeyPatch) -> None:
    upper = np.stack(np.meshgrid(*[np.linspace(0, 1, 6)] * 2, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    count, sheet = len(upper), triangles_of(grid_faces(5, 5))
    points = np.concatenate([upper, upper - [0, 0, 1e-3]])
    below = np.where(on_border(upper), 0, count) + np.arange(count)
    triangles = np.concatenate([sheet, below[sheet][:, ::-1]])

    def vertices_left() -> int:
        _, corners, _ = simplify(points[None], triangles, [], [12])[0]
        return len(np.unique(triangles.ravel()[corners]))

    assert vertices_left() <= 12
    monkeypatch.setattr(folds, "KEPT_OPENING", 9.0)
    assert vertices_left() > 18
