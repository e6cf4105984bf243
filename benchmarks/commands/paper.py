# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables and figures of ZoomOut's paper."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.command import FIGURE, FILE, FOLDER, READ_FOLDER, main, table_of_sets
from benchmarks.paper import clutter as clutter_table
from benchmarks.paper import discretisation as discretisation_table
from benchmarks.paper import downsampled as downsampled_table
from benchmarks.paper import initial_size as initial_size_table
from benchmarks.paper import large as large_table
from benchmarks.paper import overfitting as overfitting_table
from benchmarks.paper import page as paper_page
from benchmarks.paper import partial as partial_table
from benchmarks.paper import point_clouds as point_clouds_table
from benchmarks.paper import refinement as refinement_tables
from benchmarks.paper import signs as signs_table
from benchmarks.paper import step_size as step_size_table
from benchmarks.paper import symmetry as symmetry_tables
from benchmarks.tables import Tables
from zoomout_core.command_options import refusals


@table_of_sets(
    FIGURE,
    click.option(
        "--features",
        type=READ_FOLDER,
        help="Start from features in this folder, such as learned descriptors: an array (vertices, features) in "
        "SET/NAME.npy for each shape.",
    ),
)
def refinement(data: Path, pairs: int | None, figure: Path | None, features: Path | None) -> Tables:
    """ZoomOut, ICP, Deblur, PMF, RHM and BCICP from the same initial maps, beside the paper's figures."""
    if features is None:
        return refinement_tables.run(data, pairs, figure)
    with refusals():
        return refinement_tables.run_features(data, features, pairs, figure)


@table_of_sets(FIGURE)
def shrec19(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """The same methods on people of SHREC'19, beside the paper's figures."""
    return refinement_tables.run_shrec19(data, pairs, figure)


@table_of_sets(
    click.option(
        "--things/--no-things", default=True, help="Build things and characters in Blender, and measure those."
    ),
    click.option("--figure", type=FILE, help="Draw the vase's symmetries here."),
)
def symmetry(data: Path, pairs: int | None, things: bool, figure: Path | None) -> Tables:
    """Success and error of detected symmetries by criterion, and of mirroring along them."""
    return symmetry_tables.run(data, pairs, things, figure)


@table_of_sets(FIGURE)
def discretisation(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Success and error of `match` on the same people with other meshing, or as point clouds."""
    return discretisation_table.run(data, pairs, figure)


@table_of_sets(FIGURE)
def partial(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """ZoomOut and `match` on cuts, holes and people with missing pieces, beside PFM, GTM, FC and CPD."""
    return partial_table.run(data, pairs, figure)


@table_of_sets(FIGURE)
def clutter(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """ZoomOut in the basis of a region, in cut and cluttered scenes, beside LMH and PFM."""
    return clutter_table.run(data, pairs, figure)


@table_of_sets(FIGURE, name="step_size")
def step_size(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Error of ZoomOut with steps of 1 to 50, beside spectral ICP."""
    return step_size_table.run(data, pairs, figure)


@table_of_sets(FIGURE, name="initial_size")
def initial_size(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Error of ZoomOut from initial maps of several sizes, and with noise."""
    return initial_size_table.run(data, pairs, figure)


@table_of_sets(FIGURE)
def overfitting(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Error of maps fitted to descriptors against the size of the fit, beside ZoomOut."""
    return overfitting_table.run(data, pairs, figure)


@table_of_sets(FIGURE)
def large(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """ZoomOut on meshes of 19k and 52k vertices, with and without sampling, beside spectral ICP and RHM."""
    return large_table.run(data, pairs, figure)


@table_of_sets(FIGURE)
def signs(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Symmetries from the signs of the first four eigenfunctions, ranked by commutativity with the Laplacian."""
    return signs_table.run(data, pairs, figure)


@table_of_sets(FIGURE)
def downsampled(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """ZoomOut on decimated meshes, with the map lifted to the full ones, beside ZoomOut on samples of these."""
    return downsampled_table.run(data, pairs, figure)


@table_of_sets(FIGURE, name="point_clouds")
def point_clouds(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """ZoomOut, spectral ICP and `match` between clouds and meshes."""
    return point_clouds_table.run(data, pairs, figure)


@main.command()
@click.option(
    "--data", type=READ_FOLDER, help="Folder of meshes; without it, the page is written from the records beside it."
)
@click.option(
    "--pairs",
    type=click.IntRange(min=1),
    default=40,
    show_default=True,
    help="Use this many pairs of each set, evenly spread, where it has them.",
)
@click.option(
    "--records",
    type=FOLDER,
    default=Path("build/paper"),
    show_default=True,
    help="Keep the records of single pairs here, from which an interrupted run is resumed.",
)
@click.option(
    "--page",
    type=FILE,
    default=Path("docs/paper.md"),
    show_default=True,
    help="Write the page here, and figures and records to a folder beside it.",
)
@click.option("--only", multiple=True, help="Make this section anew, and keep the others as they are.")
def paper(data: Path | None, pairs: int, records: Path, page: Path, only: tuple[str, ...]) -> None:
    """Tables and figures of ZoomOut's paper on one page, beside the published figures."""
    with refusals():
        failures = paper_page.run(data, pairs, page, only, records)
    if failures:
        raise click.ClickException("Sections that could not be made: " + "; ".join(failures))
    click.echo(f"Written: {page}")
