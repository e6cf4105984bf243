# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranked signs of eigenfunctions, and errors by the size of fitted maps, on generated shapes."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from creatures import creature, mirrored_vertex

from benchmarks.paper import overfitting, signs
from benchmarks.paper.signs import Ranked, distinct_rows, rows_of
from zoomout_core.mesh.surface import Surface

pytestmark = pytest.mark.slow


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few functions, and small maps."""
    for module, name, value in (
        (signs, "SIZES", (6, 8, 10, 20, 30)),
        (overfitting, "SIZES", [10, 20, 30]),
        (overfitting, "SETS", ("creatures",)),
        (overfitting, "K_SIGNATURES", 60),
    ):
        monkeypatch.setattr(module, name, value)


def test_mirror_symmetry_ranks_first_among_signs(small: None) -> None:
    whole = creature(900)
    body, ranked = signs.ranked_signs(whole.surface)
    assert len(ranked) == 15
    errors = [each.energies["commutativity"] for each in ranked]
    assert errors == sorted(errors)
    rows = rows_of(body, ranked)
    first = next(i for i, row in enumerate(rows) if row["rank"])
    truth = mirrored_vertex(whole, whole)
    apart = np.linalg.norm(body.vertices[ranked[first].vertex] - body.vertices[truth], axis=1).mean()
    assert apart < 0.05
    assert rows[first]["there twice"] < 50


def test_repetitions_and_the_identity_are_named_and_not_shown() -> None:
    square = Surface([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    swapped = np.array([2, 3, 0, 1])
    images = [np.arange(4), swapped, swapped, swapped[::-1]]
    ranked = [Ranked("+", np.eye(2), vertex, {"commutativity": float(i)}, 0.0) for i, vertex in enumerate(images)]
    rows = rows_of(square, ranked)
    assert [row["same as"] for row in rows] == ["the identity", None, "rank 1", None]
    assert rows[1]["there twice"] == rows[1]["off a rigid motion"] == 0
    assert [row["rank"] for row in distinct_rows([{"shape": "square"} | row for row in rows])] == [1, 2]


def test_shapes_of_the_folder_have_rows_and_pictures(
    small: None, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signs, "find_spec", lambda name: None)  # without Blender there is no vase
    (tmp_path / signs.FOLDER).mkdir()
    (tmp_path / signs.FOLDER / "a.off").write_text((data / "creatures" / "a.off").read_text())
    tables = signs.run(tmp_path, None, tmp_path / "signs.png")
    assert {row["shape"] for row in tables["rows"]} == {"self_symmetry a"}
    assert 1 <= len(tables["rows"]) <= signs.SHOWN < len(tables["pairs"]) == 15
    image = matplotlib.image.imread(tmp_path / "signs.png")[:, :, :3]
    assert (np.ptp(image, axis=2) > 0.2).mean() > 0.02


def test_errors_of_fitted_and_refined_maps_are_listed_by_size(small: None, data: Path, tmp_path: Path) -> None:
    rows = overfitting.run(data, 1, tmp_path / "lines.png")["rows"]
    assert [row["size"] for row in rows] == [10, 20, 30]
    fitted, refined, true = (
        [row[f"{method}: mean"] for row in rows]
        for method in (overfitting.FITTED, overfitting.REFINED, overfitting.TRUE)
    )
    assert refined[0] is None
    assert refined[1] == fitted[1]  # where ZoomOut begins
    assert true[2] < true[1] < true[0]
    assert true[2] <= min(refined[2], fitted[2])
    assert all(row["pairs"] == 1 for row in rows)
    assert (tmp_path / "lines.png").is_file()


def test_a_folder_without_sets_makes_no_table(tmp_path: Path) -> None:
    assert overfitting.run(tmp_path, None, None)["rows"] == []
    assert signs.run(tmp_path, 0, None)["rows"] == []
