# SPDX-License-Identifier: GPL-3.0-or-later
"""Decimation in stages and by thinning, tested on small meshes with small stage sizes."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature
from reports import fractions_of

from zoomout_core.mesh import decimation
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.samples.grids import grid, grid_faces, triangles_of


@pytest.fixture(autouse=True)
def small_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decimation, "MAX_STAGE_VERTICES", 300)


def plane(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat unit square as a grid."""
    along = np.arange(side) / (side - 1.0)
    return grid(along, along).vertices, triangles_of(grid_faces(side - 1, side - 1))


@pytest.mark.parametrize("count", [100, 400, 1500])
def test_decimation_reaches_the_count_and_maps_every_vertex(count: int) -> None:
    working = creature(2500).surface.working
    points, triangles, merged = decimate(working.vertices, working.oriented_triangles, count)
    assert 0.9 * count < len(points) < 1.1 * count
    assert triangles.max() == len(points) - 1
    assert merged.shape == (2500,)
    assert merged.min() >= 0
    spacing = np.sqrt(1 / count)
    assert np.median(np.linalg.norm(points[merged] - working.vertices, axis=1)) < spacing


def test_only_meshes_much_denser_than_the_result_are_thinned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[np.ndarray] = []
    plain = decimation._simplify

    def watched(vertices: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        given.append(vertices)
        return plain(vertices, triangles, count)

    monkeypatch.setattr(decimation, "_simplify", watched)
    dense, triangles = plane(60)
    decimate(dense, triangles, 40)
    thinned = given[0]
    assert 40 < len(thinned) < 0.6 * len(dense)  # result spacing 0.16, mesh spacing 0.017
    given.clear()
    decimate(dense, triangles, 1200)
    assert len(given[0]) == len(dense)  # result spacing 0.029, mesh spacing 0.017


def test_progress_rises_to_one_across_stages() -> None:
    working = creature(2500).surface.working
    fractions = fractions_of(lambda: decimate(working.vertices, working.oriented_triangles, 200))
    assert len(fractions) > 4
    assert fractions[0] == 0
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1, abs=0.05)


def test_a_flat_square_stays_flat_and_whole() -> None:
    dense, triangles = plane(60)
    points, faces, _ = decimate(dense, triangles, 200)
    np.testing.assert_allclose(points[:, 2], 0, atol=0.1 / 60)  # a tenth of an edge, see `decimation.JITTER`
    # Thinning rounds off border corners by a fraction of the result's spacing of 0.07.
    assert 0.95 < triangle_areas(points, faces).sum() <= 1.001
