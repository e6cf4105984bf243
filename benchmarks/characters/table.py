# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of the table of characters, and their summary."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeAlias

import numpy as np

import zoomout_core as zo
from benchmarks.characters.cases import Case
from benchmarks.characters.figures import Figures, figures, nearest_in_space
from zoomout_core.matching.report.verdict import VERDICT

Row: TypeAlias = dict[str, Any]

# Smaller differences of shares and of centimetres count as equal.
EQUAL, EQUAL_ERRORS = 0.005, 0.1
DIGITS = 3
BASELINE = "DT "


def measure(case: Case) -> tuple[Row, zo.MatchResult]:
    """Match a case without hints: its row, and the result."""
    zo.forget_shapes()
    begin = perf_counter()
    result = zo.match(case.source, case.target)
    seconds = perf_counter() - begin
    ours, baseline = figures(case, result.surface_map), figures(case, nearest_in_space(case))
    row: Row = {
        "kind": case.kind,
        "case": case.name,
        "parts": f"{_parts(case.source)} {_parts(case.target)}",
        "seconds": seconds,
        "certainty": result.certainty,
        "confidence": float(result.confidence.mean()),
        **_with_prefix(ours),
        **_with_prefix(baseline, BASELINE),
        "right": ours.right,
        "behind": _behind(ours, baseline),
    }
    return row, result


def summary(rows: list[Row]) -> list[Row]:
    """For each kind and all: how many cases are right, worse than Data Transfer, and announced as right but wrong.

    Also the worst and the median limb, strongest bone and error.
    """
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    return [_sum_up(kind, [row for row in rows if kind in (row["kind"], "all")]) for kind in [*kinds, "all"]]


def badness(row: Row) -> float:
    """The figure by which the worst cases of a kind are chosen."""
    return float(row["cm"] if row["cm"] is not None else 1 - (row["limb"] or 0))


def _sum_up(kind: str, rows: list[Row]) -> Row:
    return {
        "kind": kind,
        "cases": len(rows),
        "right": sum(row["right"] for row in rows),
        "behind DT": sum(row["behind"] for row in rows),
        "certain and wrong": sum(row["certainty"] >= VERDICT.certain and not row["right"] for row in rows),
        "certain": sum(row["certainty"] >= VERDICT.certain for row in rows),
        "worst limb": over(min, rows, "limb"),
        "median limb": over(np.median, rows, "limb"),
        "worst dom": over(min, rows, "dom"),
        "median dom": over(np.median, rows, "dom"),
        "worst cm": over(max, rows, "cm"),
        "median cm": over(np.median, rows, "cm"),
        "seconds": over(np.median, rows, "seconds"),
    }


def over(statistic: Callable[[list[float]], Any], rows: list[Row], column: str) -> float | None:
    """A statistic of a column over the rows that have it."""
    values = [row[column] for row in rows if row[column] is not None]
    return float(statistic(values)) if values else None


def _with_prefix(of_map: Figures, prefix: str = "") -> Row:
    columns = ("dom", "limb", "side", "L1", "cm", "median cm")
    return {
        prefix + column: None if value is None else round(value, DIGITS)
        for column, value in zip(columns, of_map, strict=True)
    }


def _behind(ours: Figures, baseline: Figures) -> bool:
    if ours.error is not None and baseline.error is not None:
        return ours.error > baseline.error + EQUAL_ERRORS
    return (ours.limb or 0) < (baseline.limb or 0) - EQUAL


def _parts(surface: zo.Surface) -> int:
    """The number of loose parts, where parts with coincident borders count as one."""
    return int(surface.components.max()) + 1
