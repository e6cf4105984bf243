# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of tuned numbers tries half and twice of each, reports changes, and restores the values."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.tuning import halves_and_doubles as tuning
from zoomout_core.matching.refinement.confidence import CONFIDENCE
from zoomout_core.tuning import stages


def test_each_number_is_tried_with_less_and_with_more(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(tuning, "_error_of_pair", lambda _: seen.append(asdict(CONFIDENCE)) or CONFIDENCE.pooling)
    rows = tuning.run(data, 1, ["refinement.confidence"])
    own, *others = seen
    assert own == asdict(CONFIDENCE)
    for row, tried in zip(rows, others, strict=True):
        assert {name for name in own if tried[name] != own[name]} == {row["number"]}
        assert tried[row["number"]] == row["tried"] != row["value"]
    pooling = [(row["better"], row["worse"]) for row in rows if row["number"] == "pooling"]
    assert pooling == [(1, 0), (0, 1)]
    assert not any(row["better"] or row["worse"] for row in rows if row["number"] != "pooling")


def test_scaled_values_stay_in_range_and_keep_their_type() -> None:
    assert tuning._scale(((1, 4), (2, 7)), 0.5, 1, 100) == ((1, 2), (1, 4))
    assert tuning._scale(0.8, 2.0, 0, 1) == 1.0
    for stage in stages().values():
        for number, value in tuning._trials(stage):
            assert type(value) is type(getattr(stage, number))


def test_unknown_stage_is_refused(data: Path) -> None:
    outcome = CliRunner().invoke(main, ["tuning", "--data", str(data), "--stage", "nothing"])
    assert outcome.exit_code == 1
    assert "No stage is called so" in outcome.output
    assert "scores" in outcome.output
