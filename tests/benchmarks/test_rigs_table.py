# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of rigs: a row for each kind of builds and each method, with errors in percent of the height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import rigs
from benchmarks.tables import NOT_SHOWN, Record


def test_rows_join_the_errors_of_all_pairs() -> None:
    one = {"kind": rigs.JUDGED, "method": rigs.BOX} | dict.fromkeys(rigs.MEANS, 1.0)
    first = {"": np.full(3, 1.0), "body ": np.full(1, 1.0)}
    second = {"": np.full(7, 2.0), "body ": np.full(4, 5.0)}
    records = [one | {"errors": first}, one | {"errors": second, "posed": 3.0}]
    (row,) = rigs._rows(records)
    assert row["pairs"] == 2
    assert row["median"] == 2.0
    assert row["body median"] == 5.0
    assert row["posed"] == 2.0


def test_bones_are_sorted_by_error() -> None:
    def record(method: str, *errors: float) -> Record:
        return {
            "kind": rigs.JUDGED,
            "method": method,
            "bones": ("hip", "knee", "toe"),
            "errors": {"": np.array(errors)},
            "alone": np.array(errors) / 10,
        }

    records = [
        record(rigs.PRODUCT, 0.2, 1.0, 0.1),
        record(rigs.PRODUCT, 0.4, 3.0, 0.1),
        record(rigs.BY_TRUE_MAP, 0.1, 1.5, 0.0),
        record(rigs.BOX, 9.0, 9.0, 9.0),
    ]
    knee, hip, toe = rigs._bones(records)
    assert [row["bone"] for row in (knee, hip, toe)] == ["knee", "hip", "toe"]
    assert (knee[rigs.PRODUCT], knee["worst"], knee[rigs.BY_TRUE_MAP], knee["posed"]) == (2.0, 3.0, 1.5, 0.2)


def test_best_fitting_source_is_chosen() -> None:
    pairs = (("woman", "child", 0.05), ("man", "child", 0.06), ("woman", "elder", 0.09), ("man", "elder", 0.07))
    records = [
        {"kind": rigs.JUDGED, "source": source, "target": target, "misfit": misfit} for source, target, misfit in pairs
    ]
    found = rigs._as_found(records)
    assert [(record["source"], record["target"]) for record in found] == [("woman", "child"), ("man", "elder")]
    assert {record["kind"] for record in found} == {f"{rigs.JUDGED}, {rigs.AS_FOUND}"}


@pytest.mark.slow
def test_every_method_is_measured(wardrobe: Path) -> None:
    tables = rigs.run(wardrobe, 1)
    rows = {row["method"]: row for row in tables["rows"] if row["kind"] == rigs.JUDGED}
    assert set(rows) == {rigs.PRODUCT, rigs.BY_TRUE_MAP, rigs.AROUND, rigs.BOX}
    assert rows[rigs.PRODUCT]["median"] < 1
    assert rows[rigs.PRODUCT]["ratio"] >= 1
    # A joint that is off alone moves the surface less than all of them, and some joint does.
    (alone,) = (
        record["alone"]
        for record in tables[NOT_SHOWN]
        if record["method"] == rigs.PRODUCT and record["kind"] == rigs.JUDGED
    )
    assert 0 < max(alone) < 1.5 * rows[rigs.PRODUCT]["posed, true weights"]
    assert len(tables["each"]) == len(tables[NOT_SHOWN]) / len(rows)
