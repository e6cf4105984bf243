# SPDX-License-Identifier: GPL-3.0-or-later
"""Point clouds are matched as surfaces through their points, and notes report points off the surface."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, directions, true_vertex

import zoomout_core as zo
from zoomout_core.matching.report.notes import notes_on_cloud


@pytest.mark.parametrize("role", ["source", "target"])
@pytest.mark.slow(but=1)
def test_a_cloud_is_matched_with_a_mesh_without_a_hint(role: str, resting: Creature, bent: Creature) -> None:
    truth = true_vertex(resting, bent)
    cloud = zo.PointCloud((resting if role == "source" else bent).surface.vertices)
    source, target = (cloud, bent.surface) if role == "source" else (resting.surface, cloud)
    result = zo.match(source, target, k_final=60, samples=400)
    apart = np.linalg.norm(
        result.surface_map.interpolate(resting.surface.vertices) - resting.surface.vertices[truth], axis=1
    )
    assert apart.mean() < 0.03 * np.sqrt(resting.surface.area)
    assert not [note for note in result.notes if "cloud" in note]
    heights = zo.Attribute("height", zo.Domain.POINT, zo.Kind.SCALAR, resting.surface.vertices[:, 2])
    carried = zo.transfer(heights, result, source, target)
    assert np.corrcoef(carried.values, resting.surface.vertices[truth, 2])[0, 1] > 0.99


@pytest.mark.slow
def test_an_open_cloud_without_normals_has_no_outer_side() -> None:
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 24), np.linspace(-1, 1, 18)), axis=-1).reshape(-1, 2)
    grid = grid + np.random.default_rng(0).uniform(-0.01, 0.01, grid.shape)
    x, y = grid.T
    points = np.column_stack([x, y, 0.3 * x * y])
    said = "The target is an open point cloud without normals"
    source, cloud = zo.PointCloud(points).surface, zo.PointCloud(points)
    result = zo.match(source, cloud)
    assert [note for note in result.notes if note.startswith(said)]
    assert [note for note in result.use(len(result.candidates) - 1).notes if note.startswith(said)]
    facing = zo.PointCloud(points, np.tile([0.0, 0, 1], (len(points), 1)))
    assert not [note for note in zo.match(source, facing).notes if note.startswith(said)]


@pytest.mark.parametrize(("strays", "said"), [(0, False), (5, False), (60, True)])
def test_many_points_off_the_surface_are_reported(strays: int, said: bool) -> None:
    ball = directions(600, seed=1)
    far = np.linspace(4, 20, strays)[:, None] * [1.0, 0.5, 0.2]  # points on a line, which no surface passes
    cloud = zo.PointCloud(np.concatenate([ball, far]))
    notes = notes_on_cloud("target", cloud, cloud.surface)
    assert bool(notes) == said
    assert all("of the target's points are noise or differ in density" in note for note in notes)
    assert not notes_on_cloud("target", cloud.surface, cloud.surface)
