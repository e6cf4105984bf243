# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands that make tables: the options that they share, and the output of their tables."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeAlias

import click

from benchmarks.tables import NOT_SHOWN, Tables, as_text
from zoomout_core.runtime.outputs import write_whole

Option: TypeAlias = Callable[[Any], Any]

# Files and folders that must exist, and those that are written.
READ_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
READ_FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)

DATA = click.option("--data", required=True, type=READ_FOLDER, help="Folder of meshes.")
PAIRS = click.option("--pairs", type=click.IntRange(min=1), help="Use this many pairs of each set, evenly spread.")
FIGURE = click.option("--figure", type=FILE, help="Draw the figure to this image file.")
JSON = click.option("--json", "json_file", type=FILE, help="Write the tables to this file, too.")


@click.group()
def main() -> None:
    """Make tables from the meshes in a folder organised like the benchmark data."""


def table(*options: Option, name: str | None = None) -> Callable[[Callable[..., Tables]], Callable[..., Tables]]:
    """Add a command that prints the tables that a function returns, and writes them to the file of `--json`.

    Args:
        options: options of the command, whose values are the function's arguments.
        name: the command's name; the function's, with dashes, if not given.
    """

    def add(make: Callable[..., Tables]) -> Callable[..., Tables]:
        @wraps(make)
        def work(*, json_file: Path | None, **values: Any) -> None:
            report(make(**values), values.get("data"), json_file)

        command: Any = work
        for option in (JSON, *reversed(options)):
            command = option(command)
        main.command(name)(command)
        return make

    return add


def table_of_sets(
    *options: Option, name: str | None = None
) -> Callable[[Callable[..., Tables]], Callable[..., Tables]]:
    """Add a command whose tables are made from pairs of the sets in a folder, see `table`."""
    return table(DATA, PAIRS, *options, name=name)


def pictures_of(subject: str) -> Option:
    """The option of a table that also draws pictures."""
    return click.option("--pictures", type=FOLDER, help=f"Draw {subject} here.")


def report(tables: Tables, data: Path | None, json_file: Path | None) -> None:
    """Print tables, all but that of single pairs, and write all of them to a file if one is given."""
    if "rows" in tables and not any(tables.values()):
        raise click.ClickException(f"{data} holds nothing that this table is made from: give the folder of the sets.")
    shown = [as_text(rows) for name, rows in tables.items() if rows and name != NOT_SHOWN]
    click.echo("\n\n".join(shown))
    if json_file is not None:
        write_whole(json_file, json.dumps(tables, indent=2).encode())
