# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of production measure each kind of data, each level, and each way to bake."""

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.production import bakes, files, levels, links

pytestmark = pytest.mark.slow

# A program that is called like Godot, and reads the script before the files.
ENGINE = """
import json, pathlib, sys
option, script, *files = map(pathlib.Path, sys.argv[1:])
assert (option.name, script.name) == ("-s", "godot.gd"), script.read_text()
print(json.dumps([{"file": each.name, "reader": "Godot"} for each in files if each.stat().st_size]))
"""


def test_each_kind_of_data_is_linked_and_equals_the_operator() -> None:
    rows = links.link_each_kind(cell=0.04, voxel=0.03, vertices=2000)
    assert [row["data"] for row in rows[:-2]] == list(links.KINDS)
    assert all(row["layers"] and row["follows %"] > 40 and row["frames/s"] > 1 for row in rows[:-1])
    assert max(row["difference"] for row in rows[:-1]) < 1e-5
    assert rows[-1]["layers"] == rows[-3]["layers"]


def test_levels_of_detail_stay_near_the_original() -> None:
    ratios = 0.5, 0.25
    rows = levels.levels_beside_blender(0.04, ratios)
    assert [row["share"] for row in rows] == list(np.repeat(ratios, 2))
    ours, theirs = rows[::2], rows[1::2]
    assert all(0 < row["rest %"] < row["posed %"] < 2 for row in rows)
    assert all(1 < row["to made posed"] < other["to made posed"] for row, other in zip(ours, theirs, strict=True))
    assert all(row["to exact weights"] < 1.1 for row in ours)


def test_bakes_beat_cycles_in_another_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bakes, "SIZE", 128)
    monkeypatch.setattr(bakes, "CAGES", (0.02, 0.04))
    rows = bakes.bake_both(0.04, 0.03, 2000)
    assert [row["pose"] for row in rows] == ["the same", "the same", "another", "another"]
    assert rows[2]["wrong texels %"] < rows[3]["wrong texels %"] / 2
    assert rows[0]["wrong texels %"] < 20


def test_written_files_open_in_other_readers(tmp_path: Path) -> None:
    engine = tmp_path / "godot"
    engine.write_text(f"#!{sys.executable}\n{ENGINE}")
    engine.chmod(0o755)
    written, *rows = files.open_elsewhere(0.04, godot=engine)
    assert [row["file"] for row in rows if row["reader"] == "Godot"] == ["plain.glb", "draco.glb", "meshopt.glb"]
    rows = [row for row in rows if row["reader"] != "Godot"]
    plain = [row for row in rows if row["file"] == "plain.glb"]
    assert {row["reader"] for row in plain} == set(files.READERS)
    assert all(row["triangles"] == written["triangles"] for row in plain)
    assert all(row["targets"] == "Smile, Look Up" for row in plain if row["reader"] != "trimesh")
