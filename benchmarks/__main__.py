"""The command line of the benchmarks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from benchmarks import correspondence, refinement

TABLES = {"correspondence": correspondence.run, "refinement": refinement.run}


@click.command()
@click.argument("name", type=click.Choice(sorted(TABLES)))
@click.option(
    "--data", required=True, type=click.Path(exists=True, file_okay=False, path_type=Path), help="Folder of meshes."
)
@click.option("--pairs", type=int, help="Use this many pairs of each set, evenly spread over its list.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write the rows here too.")
def main(name: str, data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Make the table NAME from the meshes in a folder laid out like the benchmark data."""
    rows = TABLES[name](data, pairs)
    if not rows:
        raise click.ClickException(f"{data} holds nothing that this table is made from: give the folder of the sets.")
    show(rows)
    if json_file is not None:
        json_file.write_text(json.dumps(rows, indent=2))


def show(rows: list[dict[str, Any]]) -> None:
    """Print rows under a line of column names."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    cells = [columns, *([_cell(row.get(column)) for column in columns] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    for line in cells:
        click.echo(
            "  ".join(
                cell.rjust(width) if i else cell.ljust(width)
                for i, (cell, width) in enumerate(zip(line, widths, strict=True))
            )
        )


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
