# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of large meshes and of decimated ones, on small meshes with the same order of vertices."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import write_off
from creatures import creature

from benchmarks import datasets
from benchmarks.__main__ import main
from benchmarks.paper import downsampled, large, starts

VERTICES = 900


@pytest.fixture
def meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two poses of one mesh, in a set."""
    for name, bend in (("a", 0.0), ("b", 0.9)):
        write_off(tmp_path / f"{name}.off", creature(VERTICES, 0, bend, asymmetry=0.3).surface)
    for module in (large, downsampled):
        monkeypatch.setattr(module, "PAIRS", (("a", "b"), ("a", "missing")))
        monkeypatch.setattr(module, "K_FINAL", 40)
    monkeypatch.setattr(starts, "K_SIGNATURES", 60)
    monkeypatch.setattr(large, "K_SIGNATURES", 60)
    monkeypatch.setattr(downsampled, "K_SIGNATURES", 60)
    monkeypatch.setattr(datasets, "MAX_PLACES", 100)
    return tmp_path


def test_large_meshes_are_refined_by_each_method_and_drawn(meshes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    methods = large._methods

    def quick(pair: datasets.PairOfMeshes) -> dict[str, object]:
        found = methods(pair)
        assert "RHM" in found
        return {name: found[name] for name in ("initial", "ICP20", "ZoomOut", "ZoomOut*")}

    monkeypatch.setattr(large, "_methods", quick)
    tables = large.run(meshes, 20, meshes / "heat.png")
    rows = {row["method"]: row for row in tables["rows"]}
    assert list(rows) == ["initial", "ICP20", "ZoomOut", "ZoomOut*"]
    assert rows["ZoomOut"]["vertices"] == VERTICES
    assert rows["ZoomOut"]["mean error"] < min(20, rows["initial"]["mean error"])
    assert rows["initial"]["seconds"] is None
    assert rows["ZoomOut"]["published mean"] == large.PUBLISHED["ZoomOut"][0]
    assert (np.ptp(matplotlib.image.imread(meshes / "heat.png")[:, :, :3], axis=2) > 0.3).any()


def test_rhm_is_skipped_if_too_slow(meshes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large, "MAX_FOR_RHM", VERTICES - 1)
    assert "RHM" not in large._methods(datasets.load_same_order(meshes, "a", "b"))


def test_maps_of_decimated_meshes_reach_all_vertices(meshes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(downsampled, "VERTICES", (200, 500))
    tables = downsampled.run(meshes, None, meshes / "lines.png")
    error = {(row["method"], row["vertices"]): row["mean error"] for row in tables["rows"]}
    assert len(error) == 2 + 2 * 4
    assert error[downsampled.FULL, VERTICES] < 20
    # A map between vertices alone cannot be finer than these.
    assert error[downsampled.NEAREST, 500] < error[downsampled.NEAREST, 200]
    assert error[downsampled.FUNCTIONAL, 200] < error[downsampled.NEAREST, 200]
    assert (meshes / "lines.png").is_file()


@pytest.mark.parametrize("command", ["large", "downsampled"])
def test_a_folder_without_these_meshes_is_refused(tmp_path: Path, command: str) -> None:
    refused = CliRunner().invoke(main, [command, "--data", str(tmp_path)])
    assert refused.exit_code == 1
    assert "holds nothing" in refused.output
