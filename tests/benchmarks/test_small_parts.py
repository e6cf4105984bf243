# SPDX-License-Identifier: GPL-3.0-or-later
"""Small parts are cut off at a distance from their tips, and their matches are counted by side."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import write_off
from creatures import creature
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from benchmarks import small_parts
from benchmarks.__main__ import main
from benchmarks.datasets import CORRESPONDENCE
from benchmarks.small_parts import Limb, cut_limb
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph


def test_cut_limb_is_one_piece_around_the_tip() -> None:
    surface = creature(600).surface
    far = dijkstra(edge_graph(surface.vertices, surface.triangles), indices=[7])[0]
    part, kept = cut_limb(surface, 7, 1.0)
    assert 7 in kept
    assert 3 < len(kept) < 600
    assert far[kept].max() < 1.0
    assert part.components.max() == 0
    np.testing.assert_array_equal(part.vertices, surface.vertices[kept])


@pytest.mark.parametrize(("side", "right"), [(1, True), (-1, False)])
def test_limb_matches_are_counted_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: int, right: bool
) -> None:
    made = creature(600).surface
    for name in "ab":
        (tmp_path / "set").mkdir(exist_ok=True)
        write_off(tmp_path / "set" / f"{name}.off", made)
    every = np.arange(len(made.vertices))
    np.savez(tmp_path / "set" / CORRESPONDENCE, **dict.fromkeys(["a", "b", "b.sym"], every))
    tips = int(np.argmax(made.vertices[:, 0])), int(np.argmin(made.vertices[:, 0]))

    def matched(source: Surface, target: Surface) -> Any:
        vertex = np.asarray(cKDTree(source.vertices).query(target.vertices * [side, 1, 1])[1])
        return SimpleNamespace(surface_map=SimpleNamespace(vertex=vertex), certainty=0.95)

    monkeypatch.setattr(small_parts.zo, "match", matched)
    monkeypatch.setattr(small_parts, "LIMBS", (Limb("set", "", "arm", *tips, 0.3), Limb("none", "", "arm", 0, 1, 1)))
    (row,) = small_parts.run(tmp_path, 2)["rows"]
    assert (row["limb"], row["pairs"], row["announced"]) == ("arm", 2, 2)
    assert (row["right %"], row["of these right"]) == ((100, 2) if right else (0, 0))
    assert row["other side"] == (0 if right else 2)
    assert (row["mean"] == 0) == right


def test_a_folder_without_the_sets_is_refused(data: Path) -> None:
    refused = CliRunner().invoke(main, ["small-parts", "--data", str(data)])
    assert refused.exit_code == 1
    assert "holds nothing" in refused.output
