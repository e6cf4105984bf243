# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of the benchmarks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from benchmarks import clutter as clutter_table
from benchmarks import collection as collection_tables
from benchmarks import collection_engine as collection_engine_tables
from benchmarks import correspondence as correspondence_tables
from benchmarks import discretisation as discretisation_table
from benchmarks import downsampled as downsampled_table
from benchmarks import golden as golden_tables
from benchmarks import initial_size as initial_size_table
from benchmarks import large as large_table
from benchmarks import leave_out as leave_out_table
from benchmarks import overfitting as overfitting_table
from benchmarks import paper as paper_page
from benchmarks import partial as partial_table
from benchmarks import peers as peers_table
from benchmarks import point_clouds as point_clouds_table
from benchmarks import profile as profile_table
from benchmarks import refinement as refinement_tables
from benchmarks import scale as scale_tables
from benchmarks import signs as signs_table
from benchmarks import small_parts as small_parts_table
from benchmarks import speed as speed_tables
from benchmarks import step_size as step_size_table
from benchmarks import symmetry as symmetry_tables
from benchmarks import tuning as tuning_table
from benchmarks import wrap as wrap_table
from benchmarks.tables import NOT_SHOWN, Tables, as_text


@click.group()
def main() -> None:
    """Make tables from the meshes in a folder organised like the benchmark data."""


def common_options(command: Any) -> Any:
    """The options of every table."""
    for option in (
        click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too."),
        click.option("--pairs", type=click.IntRange(min=1), help="Use this many pairs of each set, evenly spread."),
        click.option(
            "--data",
            required=True,
            type=click.Path(exists=True, file_okay=False, path_type=Path),
            help="Folder of meshes.",
        ),
    ):
        command = option(command)
    return command


def figure_option(command: Any) -> Any:
    """The option of a table that has a figure."""
    file = click.Path(dir_okay=False, path_type=Path)
    return click.option("--figure", type=file, help="Draw the figure to this image file.")(command)


@main.command()
@common_options
@click.option("--workers", type=click.IntRange(min=1), default=2, show_default=True, help="Processes to match in.")
def collection(data: Path, pairs: int | None, json_file: Path | None, workers: int) -> None:
    """How many maps are right by themselves and once cycles were closed; --pairs: shapes of each class."""
    report(collection_tables.run(data, pairs, workers), data, json_file)


@main.command()
@common_options
@click.option("--planned", type=click.IntRange(min=10), default=10_000, show_default=True, help="Shapes of the plan.")
def collection_engine(data: Path, pairs: int | None, json_file: Path | None, planned: int) -> None:
    """What the engine of collections costs beside a plain loop; --pairs: how many shapes."""
    report(collection_engine_tables.run(data, pairs, planned), data, json_file)


@main.command()
@common_options
@click.option("--ablate", is_flag=True, help="Leave out each stage of the match in turn, too.")
@click.option(
    "--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw the worst pairs of each set here."
)
def correspondence(data: Path, pairs: int | None, json_file: Path | None, ablate: bool, pictures: Path | None) -> None:
    """How often `match` is right with no hint, how exact it is, and whether it knows; published maps beside it."""
    report(correspondence_tables.run(data, pairs, ablate, pictures), data, json_file)


@main.command()
@common_options
def leave_out(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Whole matches with and without the parts of the method that few shapes need, on the sets that need them."""
    report(leave_out_table.run(data, pairs), data, json_file)


@main.command()
@common_options
@figure_option
def refinement(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut beside ICP, Deblur, PMF, RHM and BCICP from the same initial maps, with the paper's own figures."""
    report(refinement_tables.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
def peers(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """ZoomOut alone, with all given, beside another implementation of it."""
    report({"rows": peers_table.run(data, pairs)}, data, json_file)


@main.command()
@common_options
def small_parts(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """How often `match` finds where a hand, a foot, a head or a tail was cut off, and whether it knows."""
    report(small_parts_table.run(data, pairs), data, json_file)


@main.command()
@common_options
def speed(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """How long a match takes, from 5k to 840k vertices, where the time goes, and another implementation beside it."""
    report(speed_tables.run(data, pairs), data, json_file)


@main.command()
@common_options
@figure_option
def scale(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """How the cost grows with vertices, eigenfunctions and samples: fitted exponents."""
    report(scale_tables.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
def profile(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Which functions the time of a match goes to."""
    report(profile_table.run(data, pairs), data, json_file)


@main.command()
@common_options
def transfer(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """How exactly UVs, weights, colours and the rest arrive, and how exactly by Data Transfer and MeshLab."""
    from benchmarks import transfer as transfer_tables  # it starts Blender, which the other tables do without

    report(transfer_tables.run(data, pairs), data, json_file)


@main.command()
@common_options
@click.option(
    "--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw the worst cases of each kind here."
)
def characters(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """Whether bones, limbs and places arrive on game characters and dressed bodies, beside Blender's Data Transfer."""
    from benchmarks import characters as character_tables  # it starts Blender

    report(character_tables.run(data, pairs, pictures), data, json_file)


@main.command()
@common_options
@click.option(
    "--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw the worst cases of each kind here."
)
def everywhere(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """Lost parts, limbs of the other side and torn edges of maps, and whether the verdict knows; Data Transfer too."""
    from benchmarks import everywhere as everywhere_tables  # it starts Blender

    report(everywhere_tables.run(data, pairs, pictures), data, json_file)


@main.command()
@common_options
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw each character here.")
def binding(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """How exactly posed characters, bound to a rig, follow it into other poses, beside the true weights."""
    from benchmarks import binding as binding_table  # it starts Blender

    report(binding_table.run(data, pairs, pictures), data, json_file)


@main.command()
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
def session(json_file: Path | None) -> None:
    """Presses and seconds from a fresh scene to a target that an animation poses, and how far it is off, by way."""
    from benchmarks import session as session_table  # it starts Blender

    report(session_table.run(), None, json_file)


@main.command()
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
@click.option("--page", type=click.Path(dir_okay=False, path_type=Path), help="Write the page to this Markdown file.")
@click.option("--pairs", type=click.IntRange(min=1), help="Use this many files, and this many meshes.")
def robustness(json_file: Path | None, page: Path | None, pairs: int | None) -> None:
    """What this project, pyFMaps, Data Transfer and MeshLab do with malformed files and hard meshes."""
    from benchmarks import robustness as robustness_table

    tables = robustness_table.run(pairs)
    if page is not None:
        robustness_table.write_page(tables, page)
    report(tables, None, json_file)


@main.command()
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
def load(json_file: Path | None) -> None:
    """How long a character's 60 groups, 3 UV maps, 50 shape keys and the rest take onto 100k vertices, by kind."""
    from benchmarks.transfer import load as load_table  # it starts Blender

    report(load_table.run(), None, json_file)


@main.command()
@click.option(
    "--data", required=True, type=click.Path(exists=True, file_okay=False, path_type=Path), help="Folder of meshes."
)
@click.option(
    "--table", "tables", type=click.Choice(["rows", "escape", "undo"]), multiple=True, help="Make this alone."
)
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
def window(data: Path, tables: tuple[str, ...], json_file: Path | None) -> None:
    """How long Blender's window stands still during each operator, how soon ESC ends it, and what undo costs."""
    from benchmarks import window as window_tables  # it starts Blender

    report(window_tables.run(data, tables or window_tables.TABLES), data, json_file)


@main.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
def limb(file: Path) -> None:
    """Draw the checker on an arm that a seam runs along, as it arrives by us and by Data Transfer, to an image file."""
    from benchmarks.transfer import picture

    picture.draw(file)


@main.command()
@common_options
@click.option("--things/--no-things", default=True, help="Build things and characters in Blender, and measure those.")
@click.option("--figure", type=click.Path(dir_okay=False, path_type=Path), help="Draw the vase's symmetries here.")
def symmetry(data: Path, pairs: int | None, json_file: Path | None, things: bool, figure: Path | None) -> None:
    """How often a shape's own symmetry is found, how exactly, by which criterion, and what mirroring by it is worth."""
    report(symmetry_tables.run(data, pairs, things, figure), data, json_file)


@main.command()
@common_options
@figure_option
def discretisation(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """How often `match` is right, and how exact, where the same people are meshed in other ways, or are clouds."""
    report(discretisation_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def partial(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut and `match` on cuts, holes and people with missing pieces, beside PFM, GTM, FC and CPD."""
    report(partial_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def clutter(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut in functions on a region, in a cut and cluttered scene, beside LMH and PFM."""
    report(clutter_table.run(data, pairs, figure), data, json_file)


@main.command("step_size")
@common_options
@figure_option
def step_size(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """How exact ZoomOut is with steps of 1 to 50, beside spectral ICP."""
    report(step_size_table.run(data, pairs, figure), data, json_file)


@main.command("initial_size")
@common_options
@figure_option
def initial_size(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """How exact ZoomOut is from functional maps of several sizes, and how much noise it bears."""
    report(initial_size_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def overfitting(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """How exact maps are that descriptors were fitted by, against the size of the fit, and ZoomOut beside them."""
    report(overfitting_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def large(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut on meshes of 19k and 52k vertices, on all of them and on samples, beside spectral ICP and RHM."""
    report(large_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def signs(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """Symmetries from the signs of the first four eigenfunctions, ranked by how they commute with the Laplacian."""
    report(signs_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def downsampled(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut on decimated meshes, with the map carried to the full ones, beside ZoomOut on samples of these."""
    report(downsampled_table.run(data, pairs, figure), data, json_file)


@main.command("point_clouds")
@common_options
@figure_option
def point_clouds(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut, spectral ICP and `match` between clouds and meshes."""
    report(point_clouds_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw each pair here.")
def wrap(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """The source's shape on the target's topology: distance, distortion and folds, beside closest points."""
    report(wrap_table.run(data, pairs, pictures), data, json_file)


@main.command()
@common_options
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw each case here.")
def dress(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """Outfits on other bodies: how exact, how much in the skin, how distorted, beside Blender's Surface Deform."""
    from benchmarks import dressing  # it starts Blender, which the other tables do without

    report(dressing.run(data, pairs, pictures), data, json_file)


@main.command()
@common_options
@click.option("--stage", "stages", multiple=True, help="Only stages whose name has this in it, such as `shells`.")
def tuning(data: Path, pairs: int | None, json_file: Path | None, stages: tuple[str, ...]) -> None:
    """What half of each tuned number, and twice as much, does to the maps."""
    try:
        rows = tuning_table.run(data, pairs, stages)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    report({"rows": rows}, data, json_file)


@main.command()
@click.option(
    "--data", required=True, type=click.Path(exists=True, file_okay=False, path_type=Path), help="Folder of meshes."
)
@click.option("--only", multiple=True, help="Only cases whose name begins so, such as `part`.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
@click.option(
    "--against", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="Compare with this earlier JSON."
)
def golden(data: Path, only: tuple[str, ...], json_file: Path | None, against: Path | None) -> None:
    """Hashes of maps, symmetries, transfers and errors, at 1 and 8 threads, to check that a change changes none."""
    try:
        tables = golden_tables.run(data, only, against)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    report(tables, data, json_file)
    if tables["differences"]:
        raise click.ClickException(f"{len(tables['differences'])} fields differ from those in {against}.")


@main.command()
@click.option(
    "--data", required=True, type=click.Path(exists=True, file_okay=False, path_type=Path), help="Folder of meshes."
)
@click.option("--pairs", type=click.IntRange(min=1), help="Use this many pairs of each set, evenly spread.")
@click.option(
    "--page",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("docs/paper.md"),
    show_default=True,
    help="Write the page here, and figures and records to a folder beside it.",
)
@click.option("--only", multiple=True, help="Make this section anew, and keep the others as they are.")
def paper(data: Path, pairs: int | None, page: Path, only: tuple[str, ...]) -> None:
    """Every table and figure of ZoomOut's paper on one page, with the published figures beside."""
    try:
        failures = paper_page.run(data, pairs, page, only)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    if failures:
        raise click.ClickException("Sections that could not be made: " + "; ".join(failures))
    click.echo(f"Written: {page}")


def report(tables: Tables, data: Path | None, json_file: Path | None) -> None:
    """Print tables, all but that of single pairs, and write all of them to a file if one is given."""
    if "rows" in tables and not (tables["rows"] or tables.get("parts")):
        raise click.ClickException(f"{data} holds nothing that this table is made from: give the folder of the sets.")
    shown = [as_text(rows) for name, rows in tables.items() if rows and name != NOT_SHOWN]
    click.echo("\n\n".join(shown))
    if json_file is not None:
        json_file.write_text(json.dumps(tables, indent=2))


if __name__ == "__main__":
    main()
