# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of pairs are kept, and a run that was interrupted is resumed from them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks import datasets
from benchmarks.paper import page as paper
from benchmarks.paper import refinement, refinement_methods, refinement_settings
from benchmarks.stored import read, read_or_compute, storing
from benchmarks.tables import Record, Tables


def squares(numbers: list[int], asked: list[int]) -> list[Record]:
    """Records of numbers, each of which is noted when it is computed; -1 is an interruption."""

    def square(number: int) -> list[Record]:
        if number < 0:
            raise KeyboardInterrupt
        asked.append(number)
        return [{"square": number**2}]

    return [
        record for number in numbers for record in read_or_compute([str(number)], lambda number=number: square(number))
    ]


def test_records_are_computed_once(tmp_path: Path) -> None:
    path, asked = tmp_path / "new" / "records.jsonl", []
    with pytest.raises(KeyboardInterrupt), storing(path, []):
        squares([1, 2, -1], asked)
    path.write_text(path.read_text() + '{"code": "cut o')
    with storing(path, []) as store:
        assert squares([2, 3], asked) == [{"square": 4}, {"square": 9}]
    assert asked == [1, 2, 3]
    assert len(store.reused) == 1
    assert [entry["names"] for entry in read(path)] == [["1"], ["2"], ["3"]]


def test_records_of_other_code_are_not_used(tmp_path: Path) -> None:
    code, asked = tmp_path / "code.py", []
    for text in ("a = 1", "a = 2", "a = 2"):
        code.write_text(text)
        with storing(tmp_path / "records.jsonl", [code]):
            squares([1], asked)
    assert asked == [1, 1]
    squares([1], asked)  # nothing is stored here
    assert asked == [1, 1, 1]


def test_a_section_of_the_page_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def run(data: Path, pairs: int | None, figure: Path) -> Tables:
        figure.write_bytes(b"drawn")
        return {"rows": squares([1, 2, *interruption], asked)}

    section = paper.Section("one", "One", "So.", "", lambda tables: [f"{len(tables['rows'])} rows."], run)
    monkeypatch.setattr(paper, "SECTIONS", (section,))
    page, figure = tmp_path / "paper.md", tmp_path / "paper" / "one.png"
    interruption = [-1]
    with pytest.raises(KeyboardInterrupt):
        paper.run(tmp_path, 2, page, (), tmp_path / "records")
    interruption = []
    paper.run(tmp_path, 2, page, (), tmp_path / "records")
    assert asked == [1, 2]
    assert "- 2 rows." in page.read_text()
    assert figure.read_bytes() == b"drawn"
    assert json.loads((tmp_path / "paper" / "one.json").read_text())["seconds"] > 0


def test_shrec19_starts_from_landmarks(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(data / "creatures", tmp_path / "shrec19_r")
    shutil.copytree(data / "creatures", tmp_path / "others")
    monkeypatch.setattr(refinement, "METHODS", {"initial": refinement.METHODS["initial"]})
    monkeypatch.setattr(refinement_methods, "K_FINAL", 10)
    monkeypatch.setattr(datasets, "MAX_PLACES", 50)
    with np.load(data / "creatures" / "map_ini_direct.npz") as maps:
        there = maps["a__b"]
    monkeypatch.setattr(refinement_settings, "K_SIGNATURES", 10)
    monkeypatch.setattr(refinement_settings, "from_landmarks", lambda *_: there)
    with storing(tmp_path / "records.jsonl", []):
        (row,) = refinement.run_shrec19(tmp_path, 1, None)["rows"]
    assert (row["set"], row["method"], row["pairs"]) == ("shrec19_r", "initial", 1)
    assert row["published mean"] == refinement_settings.SHREC19["initial"][0]
    assert row["mean"] < 30
    with storing(tmp_path / "records.jsonl", []) as store:
        refinement.run_shrec19(tmp_path, 1, None)
    assert len(store.reused) == 1
