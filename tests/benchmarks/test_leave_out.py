# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of matches with and without a part of the method."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from creatures import creature, true_vertex

import zoomout_core as zo
from benchmarks.tuning import leave_out
from benchmarks.tuning.leave_out import LEFT_OUT, Case, LeftOut
from zoomout_core.matching import pipeline, retry


def _cases(data: Path, max_count: int | None) -> Iterator[Case]:
    source, target = creature(500), creature(400, 1, bend=0.4)
    truth = source.surface.vertices[true_vertex(source, target)]

    def error(found: zo.SurfaceMap) -> float:
        off = np.linalg.norm(found.interpolate(source.surface.vertices) - truth, axis=1)
        return float(off.mean() / np.sqrt(source.surface.area))

    yield Case("creatures", "one", source.surface, target.surface, error)


def _reverse(candidates: list[object], *_: object) -> list[object]:
    """A replacement of `with_turned` that puts the least likely candidate first."""
    return candidates[::-1]


@pytest.mark.slow
def test_each_part_has_a_row_with_it_and_one_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        leave_out,
        "LEFT_OUT",
        (LeftOut("order", _cases, ((pipeline, "with_turned", _reverse), (retry, "with_turned", _reverse))),),
    )
    tables = leave_out.run(tmp_path, None)
    complete, without = tables["rows"]
    assert (complete["method"], without["method"]) == ("with", "without")
    assert complete["right %"] == 100
    assert without["right %"] == 0
    assert without["mean error"] == without["worst error"] == tables["pairs"][1]["error"]


@pytest.mark.parametrize("part", LEFT_OUT, ids=lambda part: part.name)
def test_replaced_functions_exist(part: LeftOut) -> None:
    for owner, name, _ in part.replacements:
        assert callable(getattr(owner, name))
