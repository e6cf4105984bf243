# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps and initial sizes of ZoomOut, from the maps of a set; large steps and noise increase errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import zoomout_core as zo
from benchmarks.datasets import load_pair, shipped_map, shipped_pairs
from benchmarks.paper import initial_size, step_size

SET = "creatures"


def test_maps_of_a_set_are_found_by_their_method(data: Path) -> None:
    folder = data / SET
    assert shipped_pairs(folder, "ini_direct") == [("a", "b")]
    assert shipped_pairs(folder, "none") == []
    pair = load_pair(folder, "a", "b")
    vertex = shipped_map(folder, "ini_direct", "a", "b")
    assert np.nanmean(pair.errors(vertex[:, None])) < 30


def test_each_step_has_a_row_beside_icp(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"START": "ini_direct", "CLASS": "a", "INITIAL": 6, "FINAL": 40, "STEPS": (2, 10)}.items():
        monkeypatch.setattr(step_size, name, value)
    assert step_size.run(data, None)["rows"] == []  # b is of another class
    monkeypatch.setattr(step_size, "CLASS", "")
    rows = {row["step"]: row for row in step_size.run(data, None, tmp_path / "steps.png")["rows"]}
    assert list(rows) == ["initial", step_size.ICP, "2", "10"]
    assert rows["2"]["mean error"] < 40
    assert all(row["pairs"] == 1 for row in rows.values())
    assert (tmp_path / "steps.png").is_file()


def test_true_maps_converge_and_noise_does_not(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {"START": "ini_direct", "SIZES": (6, 20), "FINAL": 40, "NOISES": (0.0, 5.0), "DRAWS": 4}
    for name, value in settings.items():
        monkeypatch.setattr(initial_size, name, value)
    monkeypatch.setattr(initial_size, "NOISY_SIZE", 8)
    tables = initial_size.run(data, None, tmp_path / "sizes.png")
    assert [(row["size"], row["right"]) for row in tables["rows"]] == [(6, 1), (20, 1)]
    assert tables["rows"][0]["mean error"] < tables["rows"][0]["initial"]  # six functions carry little information
    assert (tmp_path / "sizes.png").is_file()
    assert [row["draws"] for row in tables["noise"]] == [4, 4]
    assert tables["noise"][0]["converged"] == 4
    assert tables["noise"][1]["converged"] < 4


def test_true_functional_map_transfers_functions(data: Path) -> None:
    pair = load_pair(data / SET, "a", "b")
    source, target = zo.eigenbasis(pair.source, 10), zo.eigenbasis(pair.target, 10)
    carried = target.eigenvectors[:, :10] @ initial_size.true_map(pair, source, target, 10)
    there = source.eigenvectors[pair.source_vertex, :10]
    assert np.corrcoef(carried[pair.target_vertex, 1], there[:, 1])[0, 1] > 0.95


def test_non_isometric_sets_are_skipped(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(initial_size, "START", "ini_direct")
    monkeypatch.setattr(initial_size, "is_far", lambda name: name == SET)
    assert initial_size.run(data, None)["rows"] == []
