# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of times: both libraries on the same pair, stages that add up, and errors."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import write_off
from creatures import creature

from benchmarks.__main__ import main
from benchmarks.timings import profile, scale, speed

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def horses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two poses of one mesh."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "tosca_full").mkdir()
    for name, bend in (("horse0", 0.0), ("horse6", 0.9)):
        write_off(folder / "tosca_full" / f"{name}.off", creature(400, 0, bend).surface)
    return folder


@pytest.fixture(scope="module")
def tables(horses: Path) -> dict[str, list[dict]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(speed, "REPEATS", 1)
        return speed.run(horses, None)


def test_all_systems_are_measured_on_the_same_pair(tables: dict[str, list[dict]]) -> None:
    ours, fine, peer = tables["rows"]
    assert [row["system"] for row in tables["rows"]] == ["zoomout_core", "zoomout_core, fine", "pyFMaps"]
    assert ours["pair"] == fine["pair"] == peer["pair"] == "horse0 horse6"
    assert ours["vertices"] == fine["vertices"] == peer["vertices"] == 400
    assert max(ours["mean error"], fine["mean error"], peer["mean error"]) < 30
    assert 0 < ours["longest wait"] < ours["seconds"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not forget the peak")
def test_peak_memory_is_measured_per_system(horses: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(megabytes: int) -> tuple[dict, dict]:
        np.ones(megabytes << 17)
        return {}, {}

    sizes = {"large": 400, "small": 0}
    monkeypatch.setattr(speed, "SYSTEMS", {name: lambda _, size=size: measured(size) for name, size in sizes.items()})
    large, small = (row["peak MB"] for row in speed.run(horses, None)["rows"])
    assert large - small > 300


def test_stages_add_up(tables: dict[str, list[dict]]) -> None:
    for row in tables["rows"]:
        seconds = [stage["seconds"] for stage in tables["stages"] if stage["system"] == row["system"]]
        assert len(seconds) > 2
        assert sum(seconds) == pytest.approx(row["seconds"])


def test_subdivided_meshes_keep_their_order_and_their_shape() -> None:
    poses = [creature(600, 0, bend).surface for bend in (0.0, 0.9)]
    fine = [speed.subdivide_triangles(pose, 1, seed) for seed, pose in enumerate(poses)]
    np.testing.assert_array_equal(fine[0].triangles, fine[1].triangles)
    assert len(fine[0].triangles) == 4 * len(poses[0].triangles)
    for before, after in zip(poses, fine, strict=True):
        off = np.linalg.norm(after.vertices[: len(before.vertices)] - before.vertices, axis=1)
        assert 0 < off.mean() < 0.01


def test_a_folder_without_these_meshes_is_refused(tmp_path: Path) -> None:
    refused = CliRunner().invoke(main, ["speed", "--data", str(tmp_path)])
    assert refused.exit_code == 1
    assert "give the folder of the sets" in refused.output


@pytest.fixture
def michaels(tmp_path: Path) -> Path:
    (tmp_path / "tosca_full").mkdir()
    for name, bend in zip(scale.PAIR, (0.0, 0.9), strict=True):
        write_off(tmp_path / "tosca_full" / f"{name}.off", creature(2000, 0, bend).surface)
    return tmp_path


def test_growth_exponent_is_fitted_to_timings(michaels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (
        ("REPEATS", 1),
        ("DECIMATED", (1000,)),
        ("SUBDIVIDED", (0,)),
        ("LARGE", 900),
        ("FUNCTIONS", (40, 80)),
        ("SAMPLES", (200, 400)),
    ):
        monkeypatch.setattr(scale, name, value)
    figure = michaels / "growth.png"
    tables = scale.run(michaels, None, figure)
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert {row["over"] for row in tables["rows"]} == {"vertices", "functions", "samples"}
    (match,) = (row for row in tables["rows"] if row["what"] == "match")
    seconds = [point["seconds"] for point in tables["points"] if point["what"] == "match"]
    assert match["smallest"] == pytest.approx(1000, rel=0.02)
    assert match["largest"] == 2000
    slope = np.log(seconds[1] / seconds[0]) / np.log(match["largest"] / match["smallest"])
    assert match["exponent"] == pytest.approx(slope) == match["from 900 on"]


def test_profile_lists_functions_and_machine_speed(horses: Path) -> None:
    tables = profile.run(horses, 1)
    assert len(tables["rows"]) == profile.SHOWN
    own = [row["own seconds"] for row in tables["rows"]]
    assert own == sorted(own, reverse=True)
    assert any("nearest" in row["function"] or "lanczos" in row["function"] for row in tables["rows"])
    assert tables["machine"][0]["float32 GFLOP/s"] > 1
