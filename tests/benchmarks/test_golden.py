# SPDX-License-Identifier: GPL-3.0-or-later
"""Golden hashes do not depend on the run and the threads; changes, errors and missing files are reported."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from benchmarks.__main__ import main
from benchmarks.golden import table as golden
from benchmarks.golden.case import Case

NAMES = "small 60", "error no axis"


def run(folder: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["golden", "--data", str(folder), *arguments])


@pytest.mark.slow
def test_differences_from_an_earlier_run_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    absent = Case("part absent", lambda _: {}, ("absent.off",))
    cases = (*(case for case in golden.CASES if case.name in NAMES), absent)
    monkeypatch.setattr(golden, "CASES", cases)
    file = tmp_path / "golden.json"
    first = run(tmp_path, "--json", str(file))
    assert first.exit_code == 0, first.output
    assert "part absent" in first.output
    tables = json.loads(file.read_text())
    one, several, *errors = tables["pairs"]
    assert (one["threads"], several["threads"]) == golden.THREADS
    assert {**one, "threads": 0, "seconds": 0} == {**several, "threads": 0, "seconds": 0}
    assert all(record["error"].startswith("ValueError: common_axes") for record in errors)

    assert run(tmp_path, "--only", "small", "--against", str(file)).exit_code == 0
    one["confidence"] = "another"
    file.write_text(json.dumps(tables))
    changed = run(tmp_path, "--against", str(file))
    assert changed.exit_code == 1
    assert "DIFFERS: confidence" in changed.output
    assert "1 fields differ" in changed.output


def test_unknown_case_is_refused(tmp_path: Path) -> None:
    refused = run(tmp_path, "--only", "nothing")
    assert refused.exit_code == 1
    assert "No case begins with nothing; these sorts are known: whole, part" in refused.output


def test_missing_folder_of_the_json_file_is_created(tmp_path: Path) -> None:
    file = tmp_path / "build" / "golden.json"
    assert run(tmp_path, "--only", "error no axis", "--json", str(file)).exit_code == 0
    assert {record["case"] for record in json.loads(file.read_text())["pairs"]} == {"error no axis"}
