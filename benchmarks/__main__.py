# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of the benchmarks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from benchmarks import collection as collection_tables
from benchmarks import collection_engine as collection_engine_tables
from benchmarks import correspondence as correspondence_tables
from benchmarks import rigs as rigs_table
from benchmarks import small_parts as small_parts_table
from benchmarks import wrap as wrap_table
from benchmarks.golden import table as golden_tables
from benchmarks.official import lists as official_lists
from benchmarks.official import page as results_page
from benchmarks.official import records as official_records
from benchmarks.official.measure import Setting
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
from benchmarks.specimens import table as specimens_table
from benchmarks.tables import NOT_SHOWN, Tables, as_text, write_page
from benchmarks.timings import peers as peers_table
from benchmarks.timings import profile as profile_table
from benchmarks.timings import scale as scale_tables
from benchmarks.timings import speed as speed_tables
from benchmarks.tuning import halves_and_doubles as tuning_table
from benchmarks.tuning import leave_out as leave_out_table
from zoomout_core.runtime.threads import usable_cores


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
    """Number of right maps of a collection, alone and made cycle-consistent; --pairs: shapes of each class."""
    report(collection_tables.run(data, pairs, workers), data, json_file)


@main.command()
@common_options
@click.option("--planned", type=click.IntRange(min=10), default=10_000, show_default=True, help="Shapes of the plan.")
def collection_engine(data: Path, pairs: int | None, json_file: Path | None, planned: int) -> None:
    """Overhead of the collection engine over a plain loop; --pairs: number of shapes."""
    report(collection_engine_tables.run(data, pairs, planned), data, json_file)


@main.command()
@common_options
@click.option("--ablate", is_flag=True, help="Leave out each stage of the match in turn, too.")
@click.option(
    "--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw the worst pairs of each set here."
)
def correspondence(data: Path, pairs: int | None, json_file: Path | None, ablate: bool, pictures: Path | None) -> None:
    """Success, error and calibration of `match` without hints, beside published maps."""
    report(correspondence_tables.run(data, pairs, ablate, pictures), data, json_file)


@main.command()
@click.option(
    "--data",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of sets; without it, the page is written from the records.",
)
@click.option("--pairs", type=click.IntRange(min=1), help="Measure this many pairs of each list, at random.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write the tables here too.")
@click.option("--set", "names", multiple=True, help="Measure this set alone.")
@click.option("--rotate", is_flag=True, help="Turn each shape by a random rotation, which is the same in each run.")
@click.option("--scale", is_flag=True, help="Scale the target by a random factor between 0.5 and 2.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes to match in; one per core if not given.")
@click.option(
    "--page",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("docs/results.md"),
    show_default=True,
    help="Write the page of results here.",
)
@click.option(
    "--records",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of the records, which a later run resumes; beside the page, and named like it, if not given.",
)
def official(
    data: Path | None,
    pairs: int | None,
    json_file: Path | None,
    names: tuple[str, ...],
    rotate: bool,
    scale: bool,
    workers: int | None,
    page: Path,
    records: Path | None,
) -> None:
    """Whole test lists of public sets by the published protocol, beside published figures."""
    records = records or page.with_suffix("")
    try:
        lists = official_lists.lists_in(data, names) if data else []
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    official_records.run(lists, Setting(rotate, scale), pairs, records, workers or usable_cores())
    results_page.write(records, page)
    report(results_page.tables(records, [chosen.name for chosen in lists] or names), data, json_file)
    click.echo(f"\nWritten: {page}")


@main.command()
@common_options
@click.option("--slow", is_flag=True, help="Include non-rigid ICP, which takes minutes for each pair.")
def faces(data: Path, pairs: int | None, json_file: Path | None, slow: bool) -> None:
    """Expression keys on other heads, beside methods that get the true landmarks."""
    from benchmarks import faces as faces_tables  # it needs trimesh

    report(faces_tables.run(data, pairs, slow), data, json_file)


@main.command()
@common_options
def leave_out(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Whole matches without the stages that few shapes need, on the sets that need them."""
    report(leave_out_table.run(data, pairs), data, json_file)


@main.command()
@common_options
@figure_option
@click.option(
    "--features",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Start from features in this folder, such as learned descriptors: an array (vertices, features) in "
    "SET/NAME.npy for each shape.",
)
def refinement(
    data: Path, pairs: int | None, json_file: Path | None, figure: Path | None, features: Path | None
) -> None:
    """ZoomOut, ICP, Deblur, PMF, RHM and BCICP from the same initial maps, beside the paper's figures."""
    if features is None:
        report(refinement_tables.run(data, pairs, figure), data, json_file)
        return
    try:
        tables = refinement_tables.run_features(data, features, pairs, figure)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    report(tables, data, json_file)


@main.command()
@common_options
@figure_option
def shrec19(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """The same methods on people of SHREC'19, beside the paper's figures."""
    report(refinement_tables.run_shrec19(data, pairs, figure), data, json_file)


@main.command()
@common_options
def peers(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """ZoomOut alone, from the same input, beside another implementation."""
    report({"rows": peers_table.run(data, pairs)}, data, json_file)


@main.command()
@common_options
def small_parts(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """How often `match` finds the place of a hand, foot, head or tail that was cut off, and its calibration."""
    report(small_parts_table.run(data, pairs), data, json_file)


@main.command()
@common_options
@click.option("--judging", is_flag=True, help="Leave out the packs that set the numbers of the search.")
def library(data: Path, pairs: int | None, json_file: Path | None, judging: bool) -> None:
    """The right asset and family of posed and remeshed queries in a library, refusals, and seconds per query."""
    from benchmarks import library as library_table  # it starts Blender, which the other tables do without

    report(library_table.run(data, pairs, judging), data, json_file)


@main.command()
@common_options
def specimens(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Error, confidence and wall swaps of landmarks on bones and teeth, beside the map alone and the best rigid fit."""
    report(specimens_table.run(data, pairs), data, json_file)


@main.command()
@common_options
def speed(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Time of a match by stage, from 5k to 840k vertices, beside another implementation."""
    report(speed_tables.run(data, pairs), data, json_file)


@main.command()
@common_options
@figure_option
def scale(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """Growth of the time with vertices, eigenfunctions and samples, as fitted exponents."""
    report(scale_tables.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
def profile(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Time of a match by function."""
    report(profile_table.run(data, pairs), data, json_file)


@main.command()
@common_options
def transfer(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Error of transferred UVs, weights, colours and other attributes, beside Data Transfer and MeshLab."""
    from benchmarks import transfer as transfer_tables  # it starts Blender, which the other tables do without

    report(transfer_tables.run(data, pairs), data, json_file)


@main.command()
@common_options
@click.option(
    "--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw the worst cases of each kind here."
)
def characters(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """Bones, limbs and positions on game characters and dressed bodies, beside Blender's Data Transfer."""
    from benchmarks import characters as character_tables  # it starts Blender

    report(character_tables.run(data, pairs, pictures), data, json_file)


@main.command()
@common_options
@click.option(
    "--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw the worst cases of each kind here."
)
@click.option("--left-out", is_flag=True, help="Judge the verdict on pairs that set none of its numbers.")
def everywhere(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None, left_out: bool) -> None:
    """Lost parts, wrong limbs and fingers, torn edges, bindings, and the verdict, beside Data Transfer."""
    from benchmarks import everywhere as everywhere_tables  # it starts Blender

    report(everywhere_tables.run(data, pairs, pictures, left_out), data, json_file)


@main.command()
@common_options
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw each character here.")
def binding(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """Error of posed characters that are bound to a rig, in other poses, beside the true weights."""
    from benchmarks import binding as binding_table  # it starts Blender

    report(binding_table.run(data, pairs, pictures), data, json_file)


@main.command()
@click.option(
    "--table",
    "tables",
    type=click.Choice(["links", "levels", "bakes", "compression", "loaders"]),
    multiple=True,
    help="Make this alone.",
)
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw the bakes here.")
@click.option(
    "--node-modules",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Also open files in Babylon.js and three.js, and validate them; see loaders.mjs.",
)
@click.option(
    "--panda",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Also open files in Panda3D, by this Python program, which has it.",
)
@click.option(
    "--godot",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Also import files into Godot, by this program of Godot 3, such as godot3-server.",
)
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
@click.option("--page", type=click.Path(dir_okay=False, path_type=Path), help="Write the tables to this Markdown file.")
def production(
    tables: tuple[str, ...],
    pictures: Path | None,
    node_modules: Path | None,
    panda: Path | None,
    godot: Path | None,
    json_file: Path | None,
    page: Path | None,
) -> None:
    """Live links beside the operator, levels beside Blender's, bakes beside Cycles, and files in other programs."""
    from benchmarks import production as production_tables  # it starts Blender

    made = production_tables.run(tables or production_tables.TABLES, pictures, node_modules, panda, godot)
    if page is not None:
        write_page(made, page)
    report(made, None, json_file)


@main.command()
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
def session(json_file: Path | None) -> None:
    """Clicks, seconds and error of several ways from a fresh scene to a target that an animation poses."""
    from benchmarks.timings import session as session_table  # it starts Blender

    report(session_table.run(), None, json_file)


@main.command()
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
@click.option("--page", type=click.Path(dir_okay=False, path_type=Path), help="Write the page to this Markdown file.")
@click.option("--pairs", type=click.IntRange(min=1), help="Use this many files, and this many meshes.")
def robustness(json_file: Path | None, page: Path | None, pairs: int | None) -> None:
    """Behaviour of this project, pyFMaps, Data Transfer and MeshLab on malformed files and difficult meshes."""
    from benchmarks import robustness as robustness_table

    tables = robustness_table.run(pairs)
    if page is not None:
        write_page(tables, page)
    report(tables, None, json_file)


@main.command()
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it here too.")
def load(json_file: Path | None) -> None:
    """Time of transferring 60 groups, 3 UV maps, 50 shape keys and more to 100k vertices, by kind."""
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
    """The time for which each operator blocks Blender's window, the delay of ESC, and the cost of undo."""
    from benchmarks import window as window_tables  # it starts Blender

    report(window_tables.run(data, tables or window_tables.TABLES), data, json_file)


@main.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
def limb(file: Path) -> None:
    """Draw the checker on an arm with a seam, as transferred by this project and by Data Transfer, to an image file."""
    from benchmarks.transfer import picture

    picture.draw(file)


@main.command()
@common_options
@click.option("--things/--no-things", default=True, help="Build things and characters in Blender, and measure those.")
@click.option("--figure", type=click.Path(dir_okay=False, path_type=Path), help="Draw the vase's symmetries here.")
def symmetry(data: Path, pairs: int | None, json_file: Path | None, things: bool, figure: Path | None) -> None:
    """Success and error of detected symmetries by criterion, and of mirroring along them."""
    report(symmetry_tables.run(data, pairs, things, figure), data, json_file)


@main.command()
@common_options
@figure_option
def discretisation(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """Success and error of `match` on the same people with other meshing, or as point clouds."""
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
    """ZoomOut in the basis of a region, in cut and cluttered scenes, beside LMH and PFM."""
    report(clutter_table.run(data, pairs, figure), data, json_file)


@main.command("step_size")
@common_options
@figure_option
def step_size(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """Error of ZoomOut with steps of 1 to 50, beside spectral ICP."""
    report(step_size_table.run(data, pairs, figure), data, json_file)


@main.command("initial_size")
@common_options
@figure_option
def initial_size(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """Error of ZoomOut from initial maps of several sizes, and with noise."""
    report(initial_size_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def overfitting(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """Error of maps fitted to descriptors against the size of the fit, beside ZoomOut."""
    report(overfitting_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def large(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut on meshes of 19k and 52k vertices, with and without sampling, beside spectral ICP and RHM."""
    report(large_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def signs(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """Symmetries from the signs of the first four eigenfunctions, ranked by commutativity with the Laplacian."""
    report(signs_table.run(data, pairs, figure), data, json_file)


@main.command()
@common_options
@figure_option
def downsampled(data: Path, pairs: int | None, json_file: Path | None, figure: Path | None) -> None:
    """ZoomOut on decimated meshes, with the map lifted to the full ones, beside ZoomOut on samples of these."""
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
@click.option("--kind", "kinds", multiple=True, help="Only cases of this kind, such as 'strict build'.")
@click.option("--way", "ways", multiple=True, help="Only this method, such as 'dress'.")
@click.option(
    "--records", type=click.Path(dir_okay=False, path_type=Path), help="Keep cases that are done here, and resume."
)
def outfits(
    data: Path,
    pairs: int | None,
    json_file: Path | None,
    pictures: Path | None,
    kinds: tuple[str, ...],
    ways: tuple[str, ...],
    records: Path | None,
) -> None:
    """Outfits on other bodies: error, penetration of the skin, distortion, keys and bones, beside Surface Deform."""
    from benchmarks import outfits as outfits_table  # it starts Blender, which the other tables do without

    for chosen, known in ((kinds, outfits_table.KINDS), (ways, outfits_table.EVERY_WAY)):
        if not set(chosen) <= set(known):
            raise click.UsageError(f"{', '.join(chosen)}: give some of {', '.join(known)}.")
    tables = outfits_table.run(
        data, pairs, pictures, kinds or outfits_table.KINDS, ways or outfits_table.EVERY_WAY, records
    )
    report(tables, data, json_file)


@main.command()
@common_options
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw each joint here.")
def correctives(data: Path, pairs: int | None, json_file: Path | None, pictures: Path | None) -> None:
    """Shape keys that bones drive, on bodies of other builds, poses and rigs, beside copied vectors."""
    from benchmarks import correctives as correctives_table  # it starts Blender

    report(correctives_table.run(data, pairs, pictures), data, json_file)


@main.command()
@common_options
def rigs(data: Path, pairs: int | None, json_file: Path | None) -> None:
    """Joints and posed surface of rigs moved to other builds, beside scaling and the surface around each joint."""
    report(rigs_table.run(data, pairs), data, json_file)


@main.command()
@common_options
@click.option("--stage", "stages", multiple=True, help="Only stages whose name has this in it, such as `shells`.")
def tuning(data: Path, pairs: int | None, json_file: Path | None, stages: tuple[str, ...]) -> None:
    """Effect of half and twice each tuned number on the maps."""
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
    """Hashes of maps, symmetries, transfers and errors at 1 and 8 threads, to compare two versions of the code."""
    try:
        tables = golden_tables.run(data, only, against)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    report(tables, data, json_file)
    if tables["differences"]:
        raise click.ClickException(f"{len(tables['differences'])} fields differ from those in {against}.")


@main.command()
@click.option(
    "--data",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of meshes; without it, the page is written from the records beside it.",
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
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("build/paper"),
    show_default=True,
    help="Keep the records of single pairs here, from which an interrupted run is resumed.",
)
@click.option(
    "--page",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("docs/paper.md"),
    show_default=True,
    help="Write the page here, and figures and records to a folder beside it.",
)
@click.option("--only", multiple=True, help="Make this section anew, and keep the others as they are.")
def paper(data: Path | None, pairs: int, records: Path, page: Path, only: tuple[str, ...]) -> None:
    """Tables and figures of ZoomOut's paper on one page, beside the published figures."""
    try:
        failures = paper_page.run(data, pairs, page, only, records)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    if failures:
        raise click.ClickException("Sections that could not be made: " + "; ".join(failures))
    click.echo(f"Written: {page}")


def report(tables: Tables, data: Path | None, json_file: Path | None) -> None:
    """Print tables, all but that of single pairs, and write all of them to a file if one is given."""
    if "rows" in tables and not any(tables.values()):
        raise click.ClickException(f"{data} holds nothing that this table is made from: give the folder of the sets.")
    shown = [as_text(rows) for name, rows in tables.items() if rows and name != NOT_SHOWN]
    click.echo("\n\n".join(shown))
    if json_file is not None:
        json_file.write_text(json.dumps(tables, indent=2))


if __name__ == "__main__":
    main()
