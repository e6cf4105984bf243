# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of outfits: figures of things inside and outside the skin, and a row for each method."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from creatures import creature

from benchmarks import dressing
from benchmarks.binding import pictures
from benchmarks.dressing.cases import SAME, Case
from benchmarks.dressing.methods import WAYS
from benchmarks.tables import NOT_SHOWN
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

pytestmark = pytest.mark.slow


def skin(radius: float = 1.0) -> dressing._Skin:
    return dressing._Skin(ball(radius, count=900, seed=2))


def test_what_stays_as_it_was_has_no_faults() -> None:
    shirt = ball(1.1, count=300)
    found = dressing.figures(shirt, shirt.vertices, (skin(), skin()), 0.1, shirt.vertices)
    assert [found[name] for name in ("error", "in skin", "was in", "stretch", "folds")] == [0, 0, 0, 0, 0]
    assert found["thickness"] == 0


def test_faults_are_counted() -> None:
    shirt = ball(1.1, count=300)
    sunk = np.where(np.arange(300)[:, None] % 4 == 0, 0.7, 1.0) * shirt.vertices
    found = dressing.figures(shirt, sunk, (skin(), skin()), 0.1, shirt.vertices)
    assert 20 < found["in skin"] < 60
    assert found["error"] == pytest.approx(0.25 * 0.33 / 0.1, rel=0.02)
    assert found["stretch"] > 0.1
    larger = dressing.figures(shirt, 2 * shirt.vertices, (skin(), skin(2)), 0.1, None)
    assert larger["thickness"] < 0.02  # of one size of the body
    assert larger["in skin"] == 0
    assert np.isnan(larger["error"])
    turned = shirt.vertices.copy()
    ends = shirt.triangles[0, :2]
    turned[ends] = turned[ends[::-1]]
    assert dressing.figures(shirt, turned, (skin(), skin()), 0.1, None)["folds"] >= 2


def test_each_way_has_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    source, target = creature(700, 1).surface, creature(600, 2, bend=0.4).surface
    normals = source.working.vertex_normals[source.working.vertex_of]
    shirt = Surface(source.vertices + 0.03 * normals, source.triangles[:900])
    case = Case(SAME, "one", source, target, {"shirt": shirt}, 0.01, {"shirt": shirt.vertices})
    monkeypatch.setattr(dressing, "cases", lambda data, most: iter([case]))
    monkeypatch.setattr(pictures, "SQUARE", 32)
    monkeypatch.setattr(pictures, "SAMPLES", 1)
    tables = dressing.run(tmp_path, None, tmp_path / "pictures")
    by = {row["way"]: row for row in tables["rows"]}
    assert list(by) == [*WAYS, dressing.TRUE]
    assert by["dress"]["in skin"] < 1
    assert by["dress"]["in skin"] < by["nearest skin"]["in skin"]
    assert len(tables[NOT_SHOWN]) == len(by)
    assert (tmp_path / "pictures" / "one.png").is_file()
