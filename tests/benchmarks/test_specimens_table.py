# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of landmarks on specimens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from specimens import WALL, grow, hollow

from benchmarks.specimens import table as specimens
from benchmarks.tables import NOT_SHOWN
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals


def test_rigid_errors_do_not_depend_on_placement() -> None:
    points = np.random.default_rng(0).standard_normal((9, 3))
    moved = points @ np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    if np.linalg.det(np.linalg.lstsq(points, moved, rcond=None)[0]) < 0:
        moved = moved * [-1, 1, 1]
    assert specimens.rigid_errors(points, moved + 5) == pytest.approx(0, abs=1e-9)
    assert specimens.rigid_errors(points, 2 * points).mean() > 0.3


def test_area_under_curve_equals_hand_count() -> None:
    wrong = np.array([True, False, True, False])
    assert specimens.area_under_curve(np.array([4.0, 1, 2, 3]), wrong) == 0.75
    assert specimens.area_under_curve(np.arange(4.0), np.zeros(4, dtype=bool)) is None


def test_points_on_the_inner_wall_count_as_swaps() -> None:
    body = hollow(900, 0)
    truth = body.vertices[:900:50]
    assert specimens.swapped_sides(truth, truth, body) == 0
    outer = body.triangles[(body.triangles < 900).all(axis=1)]
    inner = truth - WALL * vertex_normals(body.vertices[:900], outer)[::50]
    assert specimens.swapped_sides(inner, truth, body) == len(truth)


@pytest.mark.slow
def test_each_kind_has_a_row_for_each_method(tmp_path: Path) -> None:
    source, target = hollow(900, 0), hollow(800, 1)
    (tmp_path / "shapes").mkdir()
    write_shape(source, tmp_path / "shapes" / "bone_0.ply")
    write_shape(Surface(grow(target.vertices), target.triangles), tmp_path / "shapes" / "bone_1.ply")
    marks = source.vertices[:900:60]
    np.savez(tmp_path / "landmarks.npz", bone_0=marks, bone_1=grow(marks))
    (tmp_path / "pairs.txt").write_text("bone_1 bone_0\n")
    tables = specimens.run(tmp_path, None)
    assert [(row["kind"], row["method"]) for row in tables["rows"]] == [("bone", name) for name in specimens.METHODS]
    assert all(row["mean"] < row["rigid"] for row in tables["rows"])
    assert tables["invariance"][0]["moved"] < 0.01
    groups = [row["specimens"] for row in tables["confidence"]]
    assert groups == [name for name in ("bone", "intact", "broken") for _ in specimens.METHODS]
    both, intact, broken = tables["confidence"][1::2]
    assert both["landmarks"] == intact["landmarks"] + broken["landmarks"] == 2 * len(marks)
    assert 0 == intact["missing"] < broken["missing"] <= broken["wrong"]
    unaware, aware = tables["mirror images"]
    assert unaware["flagged"] == 1
    assert aware["mean"] < 0.5 * unaware["mean"]
    assert len(tables[NOT_SHOWN]) == 6
