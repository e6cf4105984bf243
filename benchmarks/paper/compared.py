# SPDX-License-Identifier: GPL-3.0-or-later
"""Several maps of one pair, timed and measured together, and rows of such records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from time import perf_counter

import numpy as np

from benchmarks.curves import share_below
from benchmarks.datasets import PairOfMeshes
from benchmarks.tables import Record
from zoomout_core.arrays import Floats, Integers


def compare(
    pair: PairOfMeshes, methods: Mapping[str, Integers | Callable[[], Integers]], about: Record
) -> tuple[list[Record], Floats]:
    """Run methods one after the other.

    Args:
        pair: the shapes, with known places.
        methods: by name, a vertex map (n_t,), or a function that makes one.
        about: further columns of each record.

    Returns:
        A record for each method with its mean error times 1000, its seconds (None for a given map) and its curve
        (`benchmarks.curves`), and the errors (c, m) at the known places.
    """
    maps: list[Integers] = []
    seconds: list[float | None] = []
    for method in methods.values():
        begin = perf_counter()
        maps.append(method() if callable(method) else method)
        seconds.append(perf_counter() - begin if callable(method) else None)
    errors = pair.errors(np.column_stack(maps))
    head: Record = {"target": pair.target_name, "source": pair.source_name} | about
    records = [
        head | {"method": method, "error": float(np.nanmean(each)), "seconds": taken, "curve": share_below(each)}
        for method, each, taken in zip(methods, errors.T, seconds, strict=True)
    ]
    return records, errors


def rows_by(
    columns: Sequence[str], records: Sequence[Record], published: Mapping[str, tuple[float, float | None]]
) -> list[Record]:
    """A row for each different entry of some columns, of which `method` is one.

    Args:
        columns: of the records; the first ones of the rows.
        records: see `compare`.
        published: mean error and seconds that a paper has for a method.

    Returns:
        Rows with the number of pairs, mean and median over these of the mean errors, median seconds, and the published
        figures.
    """
    rows = []
    for kind in dict.fromkeys(tuple(record[column] for column in columns) for record in records):
        about = dict(zip(columns, kind, strict=True))
        chosen = [record for record in records if all(record[column] == value for column, value in about.items())]
        errors = [record["error"] for record in chosen]
        seconds = [record["seconds"] for record in chosen if record["seconds"] is not None]
        mean, taken = published.get(about["method"], (None, None))
        rows.append(
            about
            | {"pairs": len(chosen), "mean error": float(np.mean(errors)), "median error": float(np.median(errors))}
            | {"seconds": float(np.median(seconds)) if seconds else None}
            | {"published mean": mean, "published s": taken}
        )
    return rows


def mean_curves(panel: str, records: Sequence[Record], line: str = "method") -> dict[str, dict[str, Floats]]:
    """Mean curves of records, for `benchmarks.curves.draw_curves`.

    Args:
        panel: the column by which records are divided into panels.
        records: with a `curve` each.
        line: the column by which they are divided into lines.
    """
    panels: dict[str, dict[str, Floats]] = {}
    for kind in dict.fromkeys((record[panel], record[line]) for record in records):
        curves = [record["curve"] for record in records if (record[panel], record[line]) == kind]
        panels.setdefault(str(kind[0]), {})[str(kind[1])] = np.mean(curves, axis=0)
    return panels
