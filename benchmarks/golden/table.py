# SPDX-License-Identifier: GPL-3.0-or-later
"""Hashes of the library's results, to check bit by bit that a change leaves all maps as they were.

Every case is recomputed by the public functions, at one thread and at several. A file of hashes is valid for one
machine and one set of installed packages: numpy and scipy round differently on others.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import click

import zoomout_core as zo
from benchmarks.golden.case import Case
from benchmarks.golden.cases import CASES
from benchmarks.tables import Record, Tables

THREADS = 1, 8
# Fields that identify a record, and fields that may differ between runs.
CASE, COUNT, SECONDS = "case", "threads", "seconds"
NOT_COMPARED = {CASE, COUNT, SECONDS}
# The field of a case that raised an error.
ERROR = "error"


def run(data: Path, only: Sequence[str], against: Path | None) -> Tables:
    """Compute the cases, printing a line for each.

    Args:
        data: the folder of the sets; cases whose files are missing are skipped.
        only: prefixes of the names of the cases; all cases if empty.
        against: the JSON of an earlier run.

    Returns:
        `rows`: for each sort of case the number of cases, seconds at each number of threads, the number of errors, and
        the number that depend on the threads. `skipped`: cases whose files are missing. `differences`: fields that have
        changed. `pairs`: for each case and number of threads the hashes.

    Raises:
        ValueError: no case has such a name.
    """
    chosen = [case for case in CASES if not only or case.name.startswith(tuple(only))]
    unknown = [start for start in only if not any(case.name.startswith(start) for case in CASES)]
    if unknown:
        sorts = ", ".join(dict.fromkeys(case.sort for case in CASES))
        raise ValueError(f"No case begins with {', '.join(unknown)}; these sorts are known: {sorts}.")
    present = [case for case in chosen if all((data / each).exists() for each in case.needs)]
    earlier = {} if against is None else _by_case(json.loads(against.read_text())["pairs"])
    records, differences = [], []
    for record in _records(present, data):
        records.append(record)
        compared = [] if against is None else _differences(record, earlier)
        differences += compared
        fields = ", ".join(row["field"] for row in compared)
        outcome = f"  DIFFERS: {fields}" if fields else f"  {record[ERROR]}" if ERROR in record else ""
        click.echo(f"{record[CASE]:<44} {record[COUNT]} threads {record[SECONDS]:7.2f} s{outcome}")
    return {
        "rows": _summary(records),
        "skipped": [{"skipped": case.name} for case in chosen if case not in present],
        "differences": differences,
        "pairs": records,
    }


def _records(cases: Iterable[Case], data: Path) -> Iterator[Record]:
    """The hashes of each case at each number of threads, with caches emptied in between."""
    try:
        for case in cases:
            for threads in THREADS:
                zo.set_threads(threads)
                zo.store_shapes(None)
                zo.forget_shapes()
                start = perf_counter()
                try:
                    fields: dict[str, Any] = case.fields(data)
                except Exception as error:  # some cases expect an error, and others must raise the same one
                    fields = {ERROR: f"{type(error).__name__}: {error}"}
                yield {CASE: case.name, COUNT: threads, SECONDS: perf_counter() - start} | fields
    finally:
        zo.set_threads(None)


def _by_case(records: Iterable[Record]) -> dict[tuple[str, int], Record]:
    return {(record[CASE], record[COUNT]): record for record in records}


def _differences(record: Record, earlier: dict[tuple[str, int], Record]) -> list[Record]:
    """The fields that have changed, or that only one of the two runs has."""
    about = {CASE: record[CASE], COUNT: record[COUNT]}
    before = earlier.get((record[CASE], record[COUNT]))
    if before is None:
        return [about | {"field": "all", "before": "no such case", "now": None}]
    fields = [field for field in dict.fromkeys([*before, *record]) if field not in NOT_COMPARED]
    return [
        about | {"field": field, "before": _show(before.get(field)), "now": _show(record.get(field))}
        for field in fields
        if before.get(field) != record.get(field)
    ]


def _show(value: object) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value)


def _summary(records: Sequence[Record]) -> list[Record]:
    """A row for each sort of case, and one for all cases."""
    by_case = _by_case(records)
    names = list(dict.fromkeys(record[CASE] for record in records))
    depending = {name for name in names if len({_hashes(by_case[name, count]) for count in THREADS}) > 1}
    rows = []
    for sort in (*dict.fromkeys(map(_sort, names)), "all"):
        of_sort = [name for name in names if sort in ("all", _sort(name))]
        of_each = {count: [by_case[name, count] for name in of_sort] for count in THREADS}
        row: Record = {"sort": sort, "cases": len(of_sort)}
        row |= {f"seconds, {count}": sum(record[SECONDS] for record in of_each[count]) for count in THREADS}
        row["raised"] = sum(ERROR in record for record in of_each[THREADS[0]])
        row["depend on threads"] = ", ".join(name for name in of_sort if name in depending and sort != "all")
        rows.append(row)
    return rows if names else []


def _sort(name: str) -> str:
    return name.split()[0]


def _hashes(record: Record) -> str:
    return json.dumps({field: value for field, value in record.items() if field not in NOT_COMPARED})
