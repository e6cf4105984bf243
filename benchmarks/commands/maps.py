# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of maps: their success, error, calibration and reproducibility."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks import collection as collection_tables
from benchmarks import collection_engine as collection_engine_tables
from benchmarks import correspondence as correspondence_tables
from benchmarks import small_parts as small_parts_table
from benchmarks.command import (
    DATA,
    FILE,
    FOLDER,
    JSON,
    READ_FILE,
    READ_FOLDER,
    main,
    pictures_of,
    report,
    table,
    table_of_sets,
)
from benchmarks.golden import table as golden_tables
from benchmarks.official import lists as official_lists
from benchmarks.official import page as results_page
from benchmarks.official import records as official_records
from benchmarks.official.measure import Setting
from benchmarks.specimens import table as specimens_table
from benchmarks.tables import Tables, write_page
from benchmarks.timings import peers as peers_table
from benchmarks.tuning import halves_and_doubles as tuning_table
from benchmarks.tuning import leave_out as leave_out_table
from zoomout_core.command_options import refusals
from zoomout_core.runtime.outputs import make_folder
from zoomout_core.runtime.threads import usable_cores


@table_of_sets(
    click.option("--workers", type=click.IntRange(min=1), default=2, show_default=True, help="Processes to match in.")
)
def collection(data: Path, pairs: int | None, workers: int) -> Tables:
    """Number of right maps of a collection, alone and made cycle-consistent; --pairs: shapes of each class."""
    return collection_tables.run(data, pairs, workers)


@table_of_sets(
    click.option(
        "--planned", type=click.IntRange(min=10), default=10_000, show_default=True, help="Shapes of the plan."
    )
)
def collection_engine(data: Path, pairs: int | None, planned: int) -> Tables:
    """Overhead of the collection engine over a plain loop; --pairs: number of shapes."""
    return collection_engine_tables.run(data, pairs, planned)


@table_of_sets(
    click.option("--ablate", is_flag=True, help="Leave out each stage of the match in turn, too."),
    pictures_of("the worst pairs of each set"),
)
def correspondence(data: Path, pairs: int | None, ablate: bool, pictures: Path | None) -> Tables:
    """Success, error and calibration of `match` without hints, beside published maps."""
    return correspondence_tables.run(data, pairs, ablate, pictures)


@main.command()
@click.option("--data", type=READ_FOLDER, help="Folder of sets; without it, the page is written from the records.")
@click.option("--pairs", type=click.IntRange(min=1), help="Measure this many pairs of each list, at random.")
@click.option("--set", "names", multiple=True, help="Measure this set alone.")
@click.option("--rotate", is_flag=True, help="Turn each shape by a random rotation, which is the same in each run.")
@click.option("--scale", is_flag=True, help="Scale the target by a random factor between 0.5 and 2.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes to match in; one per core if not given.")
@click.option(
    "--page", type=FILE, default=Path("docs/results.md"), show_default=True, help="Write the page of results here."
)
@click.option(
    "--records",
    type=FOLDER,
    help="Folder of the records, which a later run resumes; beside the page, and named like it, if not given.",
)
@JSON
def official(
    data: Path | None,
    pairs: int | None,
    names: tuple[str, ...],
    rotate: bool,
    scale: bool,
    workers: int | None,
    page: Path,
    records: Path | None,
    json_file: Path | None,
) -> None:
    """Whole test lists of public sets by the published protocol, beside published figures."""
    records = records or page.with_suffix("")
    with refusals():
        lists = official_lists.lists_in(data, names) if data else []
        make_folder(records)
        failures = official_records.run(lists, Setting(rotate, scale), pairs, records, workers or usable_cores())
        results_page.write(records, page)
    click.echo(f"Written: {page}\n")
    report(results_page.tables(records, [chosen.name for chosen in lists] or names), data, json_file)
    if failures:
        raise click.ClickException(f"Pairs that could not be measured: {len(failures)}. The first: {failures[0]}")


@table_of_sets()
def leave_out(data: Path, pairs: int | None) -> Tables:
    """Whole matches without the stages that few shapes need, on the sets that need them."""
    return leave_out_table.run(data, pairs)


@table_of_sets()
def peers(data: Path, pairs: int | None) -> Tables:
    """ZoomOut alone, from the same input, beside another implementation."""
    return {"rows": peers_table.run(data, pairs)}


@table_of_sets()
def small_parts(data: Path, pairs: int | None) -> Tables:
    """How often `match` finds the place of a hand, foot, head or tail that was cut off, and its calibration."""
    return small_parts_table.run(data, pairs)


@table_of_sets()
def specimens(data: Path, pairs: int | None) -> Tables:
    """Error, confidence and wall swaps of landmarks on bones and teeth, beside the map alone and the best rigid fit."""
    return specimens_table.run(data, pairs)


@table(
    click.option("--page", type=FILE, help="Write the page to this Markdown file."),
    click.option("--pairs", type=click.IntRange(min=1), help="Use this many files, and this many meshes."),
)
def robustness(page: Path | None, pairs: int | None) -> Tables:
    """Behaviour of this project, pyFMaps, Data Transfer and MeshLab on malformed files and difficult meshes."""
    from benchmarks import robustness as robustness_table

    tables = robustness_table.run(pairs)
    if page is not None:
        write_page(tables, page)
    return tables


@table_of_sets(
    click.option("--stage", "stages", multiple=True, help="Only stages whose name has this in it, such as `shells`.")
)
def tuning(data: Path, pairs: int | None, stages: tuple[str, ...]) -> Tables:
    """Effect of half and twice each tuned number on the maps."""
    with refusals():
        return {"rows": tuning_table.run(data, pairs, stages)}


@main.command()
@DATA
@click.option("--only", multiple=True, help="Only cases whose name begins so, such as `part`.")
@JSON
@click.option("--against", type=READ_FILE, help="Compare with this earlier JSON.")
def golden(data: Path, only: tuple[str, ...], json_file: Path | None, against: Path | None) -> None:
    """Hashes of maps, symmetries, transfers and errors at 1 and 8 threads, to compare two versions of the code."""
    with refusals():
        tables = golden_tables.run(data, only, against)
    report(tables, data, json_file)
    if tables["differences"]:
        raise click.ClickException(f"{len(tables['differences'])} fields differ from those in {against}.")
