# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences on the paper's page agree with their tables, and the page is up to date with its records."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from benchmarks.paper import page as paper
from benchmarks.paper import readings
from benchmarks.tables import Record

DOCS = Path(__file__).parents[2] / "docs"
MADE = [section for section in paper.SECTIONS if (DOCS / "paper" / f"{section.name}.json").is_file()]


def row(method: str, mean: float, failed: float = 0.0, **others: float) -> Record:
    return {"set": "people", "method": method, "mean": mean, "median": mean, "failed %": failed, **others}


def test_the_method_with_the_smallest_error_is_named() -> None:
    rows = [
        row("initial", 90.0, 100.0),
        row("BCICP", 30.0, 50.0, seconds=6.0),
        row("PMF", 40.0, 0.0),
        row("ZoomOut", 35.0, 25.0, seconds=2.0),
        row("zo.match, nothing given", 5.0),
    ]
    said, speed = readings.refinement({"rows": rows})
    assert "the smallest mean is 30 (BCICP)" in said
    assert "ZoomOut fails on 25 % of the pairs, the others on 0 to 50 %" in said
    assert "`zo.match` has a mean of 5 and fails on 0 %" in said
    assert speed == "ZoomOut is 3 times as fast as BCICP."


@pytest.mark.parametrize(
    ("right", "said"),
    [
        ([6, 8, 9, 9], ["From a size of 4 on, 9 of 10", "From smaller starts, 6 to 8 do."]),
        ([9, 8, 9, 9], ["From a size of 4 on, 9 of 10", "From smaller starts, 8 to 9 do."]),
        ([9, 9, 9, 9], ["From a size of 2 on, 9 of 10"]),
    ],
)
def test_smallest_sufficient_initial_size_is_found(right: list[int], said: list[str]) -> None:
    rows = [{"size": 2 + n, "pairs": 10, "mean error": 9.0, "right": count} for n, count in enumerate(right)]
    found = readings.initial_size({"rows": rows})
    assert len(found) == len(said)
    for sentence, beginning in zip(found, said, strict=True):
        assert sentence.startswith(beginning)


def test_certain_and_wrong_maps_are_counted() -> None:
    match = [
        {"set": "clouds", "pairs": 5, "right": right, "certain": 4, "certain and wrong": wrong}
        for right, wrong in ((5, 0), (2, 1), (3, 1))
    ]
    (said,) = readings.point_clouds({"rows": [], "match": match})
    assert "right on 10 of 15 pairs. It is certain of 12 maps; wrong among these: 2." in said


def test_page_is_up_to_date_with_its_records() -> None:
    records = {section: json.loads((DOCS / "paper" / f"{section.name}.json").read_text()) for section in MADE}
    assert paper.as_page(records, DOCS / "paper") == (DOCS / "paper.md").read_text()


@pytest.mark.parametrize("section", MADE, ids=lambda section: section.name)
def test_every_figure_in_text_comes_from_its_table(section: paper.Section) -> None:
    tables = json.loads((DOCS / "paper" / f"{section.name}.json").read_text())["tables"]
    said = section.reading(tables)
    assert said
    # Change every figure of the tables: every sentence with a figure changes.
    changed = json.loads(json.dumps(tables), parse_float=lambda number: 3 * float(number) + 1)
    for before, after in zip(said, section.reading(changed), strict=True):
        assert before != after or not re.search(r"\d\.\d", before)
