# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of the paper: its sections, failed ones, and those taken from an earlier run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.paper import page as paper
from benchmarks.tables import Tables


def section(name: str, tables: Tables) -> paper.Section:
    def run(data: Path, pairs: int | None, figure: Path) -> Tables:
        if not tables:
            raise RuntimeError("no bases")
        figure.write_bytes(b"")
        return tables

    return paper.Section(name, name.title(), "It is so.", "Made here.", lambda made: [f"{len(made['rows'])} row."], run)


ROWS: Tables = {
    "rows": [{"method": "ICP", "error": 49.123456, "published": None, "seconds": 1}],
    "noise": [{"noise": 0.1, "converged": 4}],
    "pairs": [{"pair": "a b", "curve": [0.5]}],
}


def test_a_page_has_each_section_with_its_tables_and_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "SECTIONS", (section("one", ROWS), section("two", {})))
    page = tmp_path / "docs" / "paper.md"
    assert paper.run(tmp_path, 3, page) == ["two: RuntimeError: no bases"]
    text = page.read_text()
    assert "| ICP" in text
    assert "49.12 " in text
    assert "published |" not in text  # a column that is empty throughout
    assert "Noise:" in text
    assert "![One](paper/one.png)" in text
    assert "--pairs 3" in text
    assert "**Could not be made**: RuntimeError: no bases." in text
    assert "*Here*: Made here.\n\n- 1 row.\n" in text
    assert "curve" not in text
    assert "pairs" not in json.loads((tmp_path / "docs" / "paper" / "one.json").read_text())["tables"]


def test_only_chosen_section_is_recomputed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "paper.md"
    monkeypatch.setattr(paper, "SECTIONS", (section("one", ROWS), section("two", {})))
    paper.run(tmp_path, None, page)
    monkeypatch.setattr(paper, "SECTIONS", (section("one", {}), section("two", ROWS)))
    assert paper.run(tmp_path, None, page, ("two",)) == []
    assert page.read_text().count("| ICP") == 2


def test_without_data_the_page_is_written_from_its_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "paper.md"
    monkeypatch.setattr(paper, "SECTIONS", (section("one", ROWS),))
    paper.run(tmp_path, None, page)
    before = page.read_text()
    page.unlink()
    assert CliRunner().invoke(main, ["paper", "--page", str(page)]).exit_code == 0
    assert page.read_text() == before


def test_command_names_failed_and_unknown_sections(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "SECTIONS", (section("one", ROWS), section("two", {})))
    call = ["paper", "--data", str(tmp_path), "--page", str(tmp_path / "page.md")]
    failed = CliRunner().invoke(main, call)
    assert failed.exit_code == 1
    assert "Sections that could not be made: two: RuntimeError: no bases" in failed.output
    unknown = CliRunner().invoke(main, [*call, "--only", "three"])
    assert unknown.exit_code == 1
    assert "no section 'three': it has one, two" in unknown.output
    assert CliRunner().invoke(main, [*call, "--only", "one"]).exit_code == 1  # two is still on the page as failed


def test_every_section_is_a_command_of_its_own() -> None:
    assert {each.name for each in paper.SECTIONS} <= set(main.commands)
