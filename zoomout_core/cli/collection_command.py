# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout collection`: many shapes at once, on the cores of this machine or on a cluster."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from zoomout_core.assets.asset import WEIGHTS
from zoomout_core.assets.files import MESHES as ENDINGS
from zoomout_core.assets.files import WRITERS, inputs_of, read_asset
from zoomout_core.assets.transfer_asset import KINDS
from zoomout_core.batch import FAILED, PARTLY
from zoomout_core.cli.report import json_option
from zoomout_core.cli.transfer_command import check_kinds, check_moved_rig, check_source
from zoomout_core.collection.collection import CollectionResult, match_collection
from zoomout_core.collection.dask_engine import has_dask, local_engine, remote_engine
from zoomout_core.collection.engine import Engine, InThisProcess
from zoomout_core.collection.pairs import read_pairs
from zoomout_core.collection.pictures import draw
from zoomout_core.collection.report import PAGE, REPORT, figures_of_collection, lines_of_collection, write_reports
from zoomout_core.collection.shapes import items_of
from zoomout_core.collection.tasks import MAPS, MESHES, SHAPES
from zoomout_core.collection.through_blender import SURFACES, is_of_blender, surfaces_of
from zoomout_core.collection.transfer_records import TRANSFER_RECORDS, TransferOutcome
from zoomout_core.collection.transfer_template import transfer_template
from zoomout_core.command_options import (
    FilePath,
    OptionError,
    check_cache,
    detail_options,
    progress_bar,
    refusals,
    table_option,
    tell,
)
from zoomout_core.matching.option_table import OPTIONS
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.preparation.disk_cache import remove_shapes
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.formats.blender_files import PROGRAM, blender_command
from zoomout_core.mesh.formats.folders import meshes_of_all
from zoomout_core.messages import message_of
from zoomout_core.runtime.extras import install_hint
from zoomout_core.runtime.outputs import check_inputs_outside, check_results_folder, is_same_file
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import usable_cores

# Default number of shapes to match each shape with, if no pairs are chosen.
NEIGHBOURS = 4
# Folder in the results that exists until all is done.
CACHE = "cache"
# Places in the results that a run replaces.
REPLACED = REPORT, PAGE, MAPS, SHAPES, MESHES, SURFACES, TRANSFER_RECORDS, CACHE
# Fractions of the progress at the end of matching and of drawing.
MATCHED, DRAWN = 0.9, 0.95


@dataclass(frozen=True)
class _Choices:
    """Options of the command, as its help describes them, besides those of `detail_options`."""

    template: Path | None
    all_pairs: bool
    pairs: Path | None
    neighbours: int | None
    workers: int | None
    scheduler: str | None
    retries: int
    resume: bool
    agree: bool
    pictures: bool
    transfers: bool
    move_rig: bool
    force: bool
    kinds: str
    ending: str | None
    blender: str | None
    partial: str
    cache: Path | None


@click.command()
@click.argument("shapes", metavar="FOLDER...", nargs=-1, required=True, type=FilePath(path_type=Path))
@click.option("-o", "--output", required=True, type=FilePath(path_type=Path), help="The folder for the results.")
@click.option("--template", type=FilePath(path_type=Path), help="The file that is the source of all other shapes.")
@click.option("--all-pairs", is_flag=True, help="Match every two shapes.")
@click.option(
    "--pairs", type=FilePath(path_type=Path), help="A text file of pairs, with a source and a target per line."
)
@click.option(
    "--neighbours",
    type=click.IntRange(min=1),
    help=(
        "Match each shape with this many of the most similar ones, and add pairs until all shapes are connected (the "
        f"default, {NEIGHBOURS})."
    ),
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine (default: one per core).")
@click.option("--scheduler", metavar="ADDRESS", help="Use a running Dask cluster, such as tcp://10.0.0.1:8786.")
@click.option(
    "--retries",
    type=click.IntRange(min=0),
    default=2,
    show_default=True,
    help="How often to retry a pair after a temporary failure, such as a killed worker.",
)
@click.option(
    "--resume/--restart", default=True, show_default=True, help="Resume from existing results, or recompute everything."
)
@click.option(
    "--agree/--no-agree",
    default=True,
    show_default=True,
    help="Choose candidates that are consistent around cycles of maps.",
)
@click.option("--pictures/--no-pictures", default=True, show_default=True, help="Draw the shapes for the report.")
@click.option(
    "--transfer",
    "transfers",
    is_flag=True,
    help="With --template: transfer its data to every mesh, into OUTPUT/meshes.",
)
@click.option(
    "--move-rig",
    is_flag=True,
    help="With --transfer: move the joints of the template into each mesh, which keeps its own size and build.",
)
@click.option("--force", is_flag=True, help="With --transfer: write a target even if its match is probably wrong.")
@click.option(
    "--kinds",
    default=",".join(kind.replace(" ", "-") for kind in KINDS[:-1]),
    show_default=True,
    metavar="KIND,KIND",
    help="With --transfer: the data to transfer.",
)
@click.option(
    "--format",
    "ending",
    type=click.Choice([each[1:] for each in (*WRITERS, *OF_BLENDER)]),
    help="With --transfer: file format of the meshes (default: that of a .blend or .fbx template, else glb).",
)
@click.option("--blender", metavar="PROGRAM", help=f"Blender's, for .blend and .fbx (default: {PROGRAM}, or blender).")
@table_option(OPTIONS["partial"])
@click.option(
    "--cache",
    type=FilePath(path_type=Path),
    help="Folder in which all workers cache preprocessed shapes (default: OUTPUT/cache, deleted at the end).",
)
@json_option
@detail_options
def collection(shapes: tuple[Path, ...], output: Path, as_json: bool, **options: Any) -> None:
    """Match many shapes, and make their maps agree.

    Each shape is prepared once. FOLDER means the meshes and point clouds in it; files may be named, too. The maps are
    written pair by pair to OUTPUT/maps/SOURCE/TARGET.npz, as `zoomout match` writes them; an interrupted run resumes
    where it stopped. OUTPUT/report.html shows every shape coloured through its map, the least trusted first.

    With --template and --transfer, every mesh is written with the data of the template to OUTPUT/meshes.

    Where cycles of maps do not close, another candidate of a pair is used, so that a flip is outvoted.

    The exit code is 0 if all went well, 1 if nothing did, and 3 if some did.
    """
    names = [field.name for field in fields(_Choices)]
    choices = _Choices(**{name: options.pop(name) for name in names})  # the others are those of `detail_options`
    with refusals():
        result, received = _run(shapes, output, choices, options)
    if as_json:
        click.echo(json.dumps(figures_of_collection(result, received), indent=1))
    else:
        for line in lines_of_collection(result):
            tell(line)
        if choices.pictures and not find_spec("matplotlib"):
            tell(f"No pictures: {install_hint('plots')}.")
        tell(f"Written to {output}; open {output / PAGE}.")
    if result.failures:
        sys.exit(PARTLY if result.records else FAILED)


def _run(
    shapes: tuple[Path, ...], output: Path, choices: _Choices, accuracy: dict[str, Any]
) -> tuple[CollectionResult, dict[str, TransferOutcome] | None]:
    """Check the inputs, then match, transfer, draw, and write the report.

    Raises:
        MeshError: an input is missing or invalid, or the results cannot be written.
        OptionError: options contradict each other.
    """
    template, pairs = choices.template, choices.pairs
    _check_choices(choices)
    check_results_folder(output, REPLACED)
    if choices.cache is not None:
        check_cache(choices.cache)
    kinds = check_kinds(choices.kinds)
    files = meshes_of_all(shapes, ENDINGS)
    check_inputs_outside(inputs_of(*files, *filter(None, (template, pairs))), output, REPLACED)
    names = [item.name for item in items_of(files)]
    choices = replace(choices, ending=choices.ending or _usual_ending(template))
    carries = choices.transfers and _uses_blender(files, choices)
    if choices.transfers and not carries and template is not None:
        source = read_asset(template)
        check_source(source, str(template), kinds, f".{choices.ending}")
        if choices.move_rig:
            check_moved_rig(source, str(template), kinds)
    how: dict[str, Any] = {"template": template}
    if choices.all_pairs or pairs is not None:
        how = {"pairs": "all" if pairs is None else read_pairs(pairs, names)}
    elif template is None:
        how = {"neighbours": choices.neighbours or NEIGHBOURS}
    with _engine(choices, len(files)) as engine:
        if not choices.resume:
            _forget(output, names)
        how |= {
            "options": MatchOptions(**resolve_detail(partial=choices.partial, **accuracy)),
            "engine": engine,
            "cache": choices.cache or output / CACHE,
            "agree": choices.agree,
            "carries": carries,
            "blender": choices.blender,
        }
        with progress_bar():
            found = _match_all(files, output, how, choices, kinds)
    if choices.cache is None:
        remove_shapes(output / CACHE)
    return found


def _check_choices(choices: _Choices) -> None:
    """Check that options do not contradict each other.

    Raises:
        OptionError: they do.
    """
    template, neighbours = choices.template is not None, choices.neighbours is not None
    if sum((template, choices.all_pairs, choices.pairs is not None, neighbours)) > 1:
        raise OptionError("Give only one of --template, --all-pairs, --pairs and --neighbours.")
    if choices.transfers and not template:
        raise OptionError("--transfer copies the data of one shape: choose it with --template.")
    if choices.move_rig and not (choices.transfers and WEIGHTS in check_kinds(choices.kinds)):
        raise OptionError(
            "--move-rig moves the joints that come with skin weights: add --transfer, and these to --kinds."
        )


def _forget(output: Path, names: Sequence[str]) -> None:
    """Remove the results of an earlier run on shapes with these names, and nothing else."""
    for name in names:
        for made in (output / SHAPES / f"{name}.npz", output / TRANSFER_RECORDS / f"{name}.json"):
            made.unlink(missing_ok=True)
        for other in names:
            (output / MAPS / name / f"{other}.npz").unlink(missing_ok=True)
        for made in surfaces_of(name, output):
            made.unlink()


def _usual_ending(template: Path | None) -> str:
    """The default extension of results."""
    return template.suffix[1:].lower() if template is not None and is_of_blender(template) else "glb"


def _uses_blender(files: Sequence[Path], choices: _Choices) -> bool:
    """Whether Blender transfers the data of a template.

    Raises:
        MeshError: Blender is needed, but missing.
    """
    template, program = choices.template, choices.blender
    has_to = f".{choices.ending}" in OF_BLENDER or (template is not None and is_of_blender(template))
    if not has_to and not any(map(is_of_blender, files)):
        return False
    try:
        blender_command(program)
    except MeshError:
        if has_to or program is not None:
            raise
        return False  # the files that need it fail one by one, and the others do not need it
    return True


def _engine(choices: _Choices, count: int) -> AbstractContextManager[Engine]:
    """The engine: a running cluster, or processes on this machine, at most one per core and shape."""
    workers = choices.workers
    if choices.scheduler is not None:
        if workers is not None:
            raise OptionError("A cluster has workers of its own: leave out --workers or --scheduler.")
        return remote_engine(choices.scheduler, choices.retries)
    if workers is None:
        workers = min(usable_cores(), count) if has_dask() else 1
    return local_engine(workers, choices.retries)


def _match_all(
    files: Sequence[Path], output: Path, how: dict[str, Any], choices: _Choices, kinds: Sequence[str]
) -> tuple[CollectionResult, dict[str, TransferOutcome] | None]:
    """Match, transfer, draw, and write the report."""
    with portion(0.0, MATCHED):
        result = match_collection(files, output, **how)
    try:
        return result, _complete(result, output, how["engine"], choices, kinds)
    except (ValueError, OSError) as error:
        raise MeshError(
            f"{message_of(error)} The maps are in {output / MAPS}: run the command again to finish."
        ) from error


def _complete(
    result: CollectionResult, output: Path, engine: Engine, choices: _Choices, kinds: Sequence[str]
) -> dict[str, TransferOutcome] | None:
    """Transfer, draw and write the report; returns the notes of a transfer on each target."""
    received, drawn, named = None, {}, choices.template
    template = next((each.name for each in result.items.values() if named and is_same_file(each.file, named)), None)
    # The next steps read the results as files.
    engine = engine if engine.sees([output]) else InThisProcess()
    if choices.transfers and template is not None and choices.ending is not None:
        with portion(MATCHED, DRAWN):
            received = transfer_template(
                result, template, kinds, choices.ending, engine, choices.blender, choices.force, choices.move_rig
            )
    if choices.pictures and find_spec("matplotlib"):
        with portion(DRAWN, 1.0):
            drawn = draw(result, template, engine)
    write_reports(result, drawn, received)
    return received
