# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of running time: of matches, of stages, of sessions in Blender."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.command import DATA, FIGURE, table, table_of_sets
from benchmarks.tables import Tables
from benchmarks.timings import profile as profile_table
from benchmarks.timings import scale as scale_tables
from benchmarks.timings import speed as speed_tables


@table_of_sets()
def speed(data: Path, pairs: int | None) -> Tables:
    """Time of a match by stage, from 5k to 840k vertices, beside another implementation."""
    return speed_tables.run(data, pairs)


@table_of_sets(FIGURE)
def scale(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Growth of the time with vertices, eigenfunctions and samples, as fitted exponents."""
    return scale_tables.run(data, pairs, figure)


@table_of_sets()
def profile(data: Path, pairs: int | None) -> Tables:
    """Time of a match by function."""
    return profile_table.run(data, pairs)


@table()
def session() -> Tables:
    """Clicks, seconds and error of several ways from a fresh scene to a target that an animation poses."""
    from benchmarks.timings import session as session_table  # it starts Blender

    return session_table.run()


@table()
def load() -> Tables:
    """Time of transferring 60 groups, 3 UV maps, 50 shape keys and more to 100k vertices, by kind."""
    from benchmarks.transfer import load as load_table  # it starts Blender

    return load_table.run()


@table(
    DATA,
    click.option(
        "--table", "tables", type=click.Choice(["rows", "escape", "undo"]), multiple=True, help="Make this alone."
    ),
)
def window(data: Path, tables: tuple[str, ...]) -> Tables:
    """The time for which each operator blocks Blender's window, the delay of ESC, and the cost of undo."""
    from benchmarks import window as window_tables  # it starts Blender

    return window_tables.run(data, tables or window_tables.TABLES)
