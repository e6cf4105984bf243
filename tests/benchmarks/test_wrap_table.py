# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of wraps: its figures on shapes with known folds and offsets, and its rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from creatures import creature

from benchmarks import wrap
from benchmarks.tables import NOT_SHOWN
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

pytestmark = pytest.mark.slow


@pytest.fixture
def sphere() -> Surface:
    return ball(1, count=400, seed=2)


def test_a_shape_on_itself_has_no_faults(sphere: Surface) -> None:
    found = wrap.figures(sphere.vertices, sphere, sphere, np.ones(400, dtype=bool))
    assert found["on source"] == 100
    assert [found[name] for name in ("against", "folds", "crossing")] == [0, 0, 0]
    assert found["angle"] == pytest.approx(0, abs=1e-6)
    assert found["edges"] == pytest.approx(0, abs=1e-9)


def test_faults_are_counted(sphere: Surface) -> None:
    every = np.ones(400, dtype=bool)
    moved = sphere.vertices.copy()
    ends = sphere.triangles[0, :2]
    moved[ends] = moved[ends[::-1]]  # the faces around them fold over
    found = wrap.figures(moved, sphere, sphere, every)
    assert found["on source"] == 100
    assert found["against"] >= 2
    assert found["folds"] >= 2
    assert found["crossing"] >= 2
    assert found["angle"] > 0.2
    assert found["edges"] > 0.02
    away = np.where(np.arange(400)[:, None] < 100, 1.01, 1.0) * sphere.vertices
    assert wrap.figures(away, sphere, sphere, every)["on source"] == 75
    # Vertices without a partner do not count.
    assert wrap.figures(away, sphere, sphere, np.arange(400) >= 100)["on source"] == 100


def test_each_set_has_a_row_for_each_method(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    source, target = creature(700, 1).surface, creature(600, 2, bend=0.5).surface
    monkeypatch.setattr(wrap, "pairs_in", lambda data, most: iter([("made", "one", source, target)]))
    tables = wrap.run(tmp_path, None, tmp_path / "pictures")
    assert [(row["set"], row["method"]) for row in tables["rows"]] == [
        (kind, method) for kind in ("made", "all") for method in wrap.METHODS
    ]
    by = {row["method"]: row for row in tables["rows"]}
    assert by["wrap"]["on source"] > 98
    assert by["wrap"]["against"] == 0
    assert len(tables[NOT_SHOWN]) == len(wrap.METHODS)
    assert (tmp_path / "pictures" / "one.png").is_file()


def test_a_folder_without_sets_has_no_rows(tmp_path: Path) -> None:
    assert wrap.run(tmp_path, None)["rows"] == []
