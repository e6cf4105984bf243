# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of the benchmarks: a command for each table."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks import collection as collection_tables
from benchmarks import collection_engine as collection_engine_tables
from benchmarks import correspondence as correspondence_tables
from benchmarks import rigs as rigs_table
from benchmarks import small_parts as small_parts_table
from benchmarks import wrap as wrap_table
from benchmarks.command import (
    DATA,
    FIGURE,
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
from benchmarks.tables import Tables, write_page
from benchmarks.timings import peers as peers_table
from benchmarks.timings import profile as profile_table
from benchmarks.timings import scale as scale_tables
from benchmarks.timings import speed as speed_tables
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


@table_of_sets(click.option("--slow", is_flag=True, help="Include non-rigid ICP, which takes minutes for each pair."))
def faces(data: Path, pairs: int | None, slow: bool) -> Tables:
    """Expression keys on other heads, beside methods that get the true landmarks."""
    from benchmarks import faces as faces_tables  # it needs trimesh

    return faces_tables.run(data, pairs, slow)


@table_of_sets()
def leave_out(data: Path, pairs: int | None) -> Tables:
    """Whole matches without the stages that few shapes need, on the sets that need them."""
    return leave_out_table.run(data, pairs)


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


@table_of_sets()
def peers(data: Path, pairs: int | None) -> Tables:
    """ZoomOut alone, from the same input, beside another implementation."""
    return {"rows": peers_table.run(data, pairs)}


@table_of_sets()
def small_parts(data: Path, pairs: int | None) -> Tables:
    """How often `match` finds the place of a hand, foot, head or tail that was cut off, and its calibration."""
    return small_parts_table.run(data, pairs)


@table_of_sets(click.option("--judging", is_flag=True, help="Leave out the packs that set the numbers of the search."))
def library(data: Path, pairs: int | None, judging: bool) -> Tables:
    """The right asset and family of posed and remeshed queries in a library, refusals, and seconds per query."""
    from benchmarks import library as library_table  # it starts Blender, which the other tables do without

    return library_table.run(data, pairs, judging)


@table_of_sets()
def specimens(data: Path, pairs: int | None) -> Tables:
    """Error, confidence and wall swaps of landmarks on bones and teeth, beside the map alone and the best rigid fit."""
    return specimens_table.run(data, pairs)


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


@table_of_sets()
def transfer(data: Path, pairs: int | None) -> Tables:
    """Error of transferred UVs, weights, colours and other attributes, beside Data Transfer and MeshLab."""
    from benchmarks import transfer as transfer_tables  # it starts Blender, which the other tables do without

    return transfer_tables.run(data, pairs)


@table_of_sets(pictures_of("the worst cases of each kind"))
def characters(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """Bones, limbs and positions on game characters and dressed bodies, beside Blender's Data Transfer."""
    from benchmarks import characters as character_tables  # it starts Blender

    return character_tables.run(data, pairs, pictures)


@table_of_sets(
    pictures_of("the worst cases of each kind"),
    click.option("--left-out", is_flag=True, help="Judge the verdict on pairs that set none of its numbers."),
)
def everywhere(data: Path, pairs: int | None, pictures: Path | None, left_out: bool) -> Tables:
    """Lost parts, wrong limbs and fingers, torn edges, bindings, and the verdict, beside Data Transfer."""
    from benchmarks import everywhere as everywhere_tables  # it starts Blender

    return everywhere_tables.run(data, pairs, pictures, left_out)


@table_of_sets(pictures_of("each character"))
def binding(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """Error of posed characters that are bound to a rig, in other poses, beside the true weights."""
    from benchmarks import binding as binding_table  # it starts Blender

    return binding_table.run(data, pairs, pictures)


@table(
    click.option(
        "--table",
        "tables",
        type=click.Choice(["links", "levels", "bakes", "compression", "loaders"]),
        multiple=True,
        help="Make this alone.",
    ),
    pictures_of("the bakes"),
    click.option(
        "--node-modules",
        type=READ_FOLDER,
        help="Also open files in Babylon.js and three.js, and validate them; see loaders.mjs.",
    ),
    click.option("--panda", type=READ_FILE, help="Also open files in Panda3D, by this Python program, which has it."),
    click.option(
        "--godot",
        type=READ_FILE,
        help="Also import files into Godot, by this program of Godot 3, such as godot3-server.",
    ),
    click.option("--page", type=FILE, help="Write the tables to this Markdown file."),
)
def production(
    tables: tuple[str, ...],
    pictures: Path | None,
    node_modules: Path | None,
    panda: Path | None,
    godot: Path | None,
    page: Path | None,
) -> Tables:
    """Live links beside the operator, levels beside Blender's, bakes beside Cycles, and files in other programs."""
    from benchmarks import production as production_tables  # it starts Blender

    made = production_tables.run(tables or production_tables.TABLES, pictures, node_modules, panda, godot)
    if page is not None:
        write_page(made, page)
    return made


@table()
def session() -> Tables:
    """Clicks, seconds and error of several ways from a fresh scene to a target that an animation poses."""
    from benchmarks.timings import session as session_table  # it starts Blender

    return session_table.run()


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


@main.command()
@click.argument("file", type=FILE)
def limb(file: Path) -> None:
    """Draw the checker on an arm with a seam, as transferred by this project and by Data Transfer, to an image file."""
    from benchmarks.transfer import picture

    picture.draw(file)


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


@table_of_sets(pictures_of("each pair"))
def wrap(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """The source's shape on the target's topology: distance, distortion and folds, beside closest points."""
    return wrap_table.run(data, pairs, pictures)


@table_of_sets(
    pictures_of("each case"),
    click.option("--kind", "kinds", multiple=True, help="Only cases of this kind, such as 'strict build'."),
    click.option("--way", "ways", multiple=True, help="Only this method, such as 'dress'."),
    click.option("--records", type=FILE, help="Keep cases that are done here, and resume."),
)
def outfits(
    data: Path,
    pairs: int | None,
    pictures: Path | None,
    kinds: tuple[str, ...],
    ways: tuple[str, ...],
    records: Path | None,
) -> Tables:
    """Outfits on other bodies: error, penetration of the skin, distortion, keys and bones, beside Surface Deform."""
    from benchmarks import outfits as outfits_table  # it starts Blender, which the other tables do without

    for chosen, known in ((kinds, outfits_table.KINDS), (ways, outfits_table.EVERY_WAY)):
        if not set(chosen) <= set(known):
            raise click.UsageError(f"{', '.join(chosen)}: give some of {', '.join(known)}.")
    kinds, ways = kinds or outfits_table.KINDS, ways or outfits_table.EVERY_WAY
    return outfits_table.run(data, pairs, pictures, kinds, ways, records)


@table_of_sets(pictures_of("each joint"))
def correctives(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """Shape keys that bones drive, on bodies of other builds, poses and rigs, beside copied vectors."""
    from benchmarks import correctives as correctives_table  # it starts Blender

    return correctives_table.run(data, pairs, pictures)


@table_of_sets()
def rigs(data: Path, pairs: int | None) -> Tables:
    """Joints and posed surface of rigs moved to other builds, beside scaling and the surface around each joint."""
    return rigs_table.run(data, pairs)


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


if __name__ == "__main__":
    main()
