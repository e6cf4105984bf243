# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of records as text and as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from tabulate import tabulate

Record: TypeAlias = dict[str, Any]
Tables: TypeAlias = dict[str, list[Record]]

# Records of single pairs are written to JSON only.
NOT_SHOWN = "pairs"


def as_text(rows: list[Record]) -> str:
    """Records under a line of column names; empty columns are left out."""
    return _table(rows, "plain")


def as_markdown(rows: list[Record]) -> str:
    """The same as a Markdown table."""
    return _table(rows, "github")


def write_page(tables: Tables, path: Path) -> None:
    """Write the tables into a page, between its paragraphs on them; create the page if it is missing."""
    text = path.read_text(encoding="utf-8") if path.exists() else "".join(_place(name) for name in tables)
    for name, rows in tables.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"
        before, _, rest = text.partition(begin)
        _, _, after = rest.partition(end)
        text = f"{before}{begin}\n{as_markdown(rows)}\n\n{end}{after}"
    path.write_text(text, encoding="utf-8")


def _place(name: str) -> str:
    return f"<!-- {name} -->\n<!-- end of {name} -->\n\n"


def over(statistic: Callable[[list[float]], Any], records: Sequence[Record], column: str) -> float | None:
    """A statistic of a column over the records that have it; None if none has."""
    values = [record[column] for record in records if record.get(column) is not None]
    return float(statistic(values)) if values else None


def _table(rows: list[Record], form: str) -> str:
    columns = [name for name in rows[0] if any(row.get(name) is not None for row in rows)]
    cells = [[_cell(row.get(column)) for column in columns] for row in rows]
    align = ("left", *["right"] * (len(columns) - 1))
    return tabulate(cells, headers=columns, tablefmt=form, colalign=align, disable_numparse=True)


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
