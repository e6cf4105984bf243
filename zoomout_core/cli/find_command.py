# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout find`: the characters of a library that fit new bodies best."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from zoomout_core.assets.files import MESHES, inputs_of
from zoomout_core.batch import FAILED, PARTLY
from zoomout_core.cli.report import json_option, say
from zoomout_core.collection.report import PAGE, REPORT
from zoomout_core.collection.shapes import items_of
from zoomout_core.command_options import FilePath, progress_bar, refusals
from zoomout_core.library.find_all import find_all
from zoomout_core.library.found import FoundPart, FoundSource, FoundSources
from zoomout_core.library.library import INDEX, Library, find_source
from zoomout_core.library.report import figures_of_targets, lines_of_targets, write_reports
from zoomout_core.library.target_records import MADE, PICTURES, RECORDS
from zoomout_core.library.transfers import TransferMode
from zoomout_core.mesh.formats.folders import meshes_of_all
from zoomout_core.messages import message, note_figures, note_lines, probability
from zoomout_core.runtime.outputs import OutputError, check_inputs_outside, check_results_folder

NOT_PREPARED = "Files of the library that are not prepared: {count}; `zoomout library` prepares them or says why not."
# Places in the results that a run replaces.
REPLACED = REPORT, PAGE, MADE, PICTURES, RECORDS


@click.command()
@click.argument("targets", metavar="TARGETS...", nargs=-1, required=True, type=FilePath(path_type=Path))
@click.option(
    "--library",
    "folders",
    multiple=True,
    required=True,
    type=FilePath(),
    help="A folder that `zoomout library` has prepared. May be repeated.",
)
@click.option(
    "--index",
    type=FilePath(file_okay=False),
    help=f"Folder of the index of a single library (default: {INDEX} in it).",
)
@click.option(
    "-o",
    "--output",
    type=FilePath(path_type=Path),
    help="The folder for the results; required for several targets.",
)
@click.option(
    "--compare",
    type=click.IntRange(min=1),
    help="Match this many of the nearest characters, about two seconds each (default: at most 4).",
)
@click.option("--transfer", is_flag=True, help="Write each target with all data of its source, as `zoomout transfer`.")
@click.option("--move-rig", is_flag=True, help="The same, and move the joints of the source into the target.")
@click.option(
    "--parts",
    is_flag=True,
    help="With one of these, also transfer from the other source that is proposed for a part, to this part alone.",
)
@click.option("--force", is_flag=True, help="Write a target even if its match is probably wrong.")
@click.option(
    "--resume/--restart", default=True, show_default=True, help="Resume from existing results, or recompute everything."
)
@json_option
def find(
    targets: tuple[Path, ...],
    folders: tuple[str, ...],
    index: str | None,
    output: Path | None,
    compare: int | None,
    transfer: bool,
    move_rig: bool,
    parts: bool,
    force: bool,
    resume: bool,
    as_json: bool,
) -> None:
    """Find the characters of a library that fit TARGETS.

    They may be in any pose, orientation and unit; a folder stands for the meshes in it.

    With --output, OUTPUT/report.html shows each target beside its source in matching colours. With --transfer or
    --move-rig, the targets are written to OUTPUT/targets with the data of their sources. An interrupted run resumes.

    The exit code is 0 if a source was found for all targets, 1 if for none, and 3 if for some.
    """
    if index is not None and len(folders) > 1:
        raise click.UsageError("--index works with a single library: give one --library, or leave --index out.")
    if parts and not (transfer or move_rig):
        raise click.UsageError("--parts has nothing to transfer: give --transfer or --move-rig, too.")
    with refusals():
        if output is None and (transfer or move_rig or len(targets) > 1 or targets[0].is_dir()):
            raise click.UsageError("Several targets, --transfer and --move-rig need a folder for the results: give -o.")
        libraries = [Library(folder, index) for folder in folders]
        new = sum(len(library.new_files()) for library in libraries)
        notes = [message(NOT_PREPARED, count=new)] if new else []
        if output is None:
            with progress_bar():
                found = find_source(targets[0], libraries, compare)
            figures = {"target": str(targets[0]), **_figures(found), **note_figures(notes)}
            say([*_lines(found), *note_lines(notes)], figures, as_json)
            sys.exit(FAILED if found.refusal else 0)
        check_results_folder(output, REPLACED)
        files = meshes_of_all(targets, MESHES)
        check_inputs_outside([*inputs_of(*files), *map(Path, folders)], output, REPLACED)
        if transfer or move_rig:
            _check_outside_libraries(output, folders)
        mode = TransferMode.RIG if move_rig else TransferMode.DATA if transfer else TransferMode.NOTHING
        named = {item.name: item.path for item in items_of(files)}
        with progress_bar():
            result = find_all(named, libraries, output, mode, compare=compare, parts=parts, force=force, resume=resume)
        write_reports(result)
    lines = [*lines_of_targets(result), *note_lines(notes), f"Written to {output}; open {output / PAGE}."]
    say(lines, {**figures_of_targets(result), **note_figures(notes)}, as_json)
    fitting = [bool(record.source) for record in result.records.values()] + [False] * len(result.failures)
    if not all(fitting):
        sys.exit(PARTLY if any(fitting) else FAILED)


def _check_outside_libraries(output: Path, folders: Sequence[str]) -> None:
    """Raise an OutputError if a library would take the results for its characters."""
    for folder in folders:
        if Path(os.path.realpath(output)).is_relative_to(os.path.realpath(folder)):
            raise OutputError(
                f"{output} is in the library {folder}, which would take the results for its characters: "
                "choose another output folder."
            )


def _lines(found: FoundSources) -> list[str]:
    lines = [each for each in (found.refusal, found.note) if each]
    lines += [f"{number}. {_line(each)}" for number, each in enumerate(found.ranked, start=1)]
    return lines + ([] if found.part is None else [found.part.sentence])


def _line(found: FoundSource) -> str:
    doubt = "" if found.fits else "; does not fit"
    return f"{found.path}: fit {1 - found.misfit:.0%}, {probability(found.certainty)} certain{doubt}."


def _figures(found: FoundSources) -> dict[str, Any]:
    return {
        "best": None if found.best is None else str(found.best.path),
        "refusal": found.refusal or None,
        "nearest": None if found.nearest is None else str(found.nearest),
        "assets": _rows(found.ranked),
        "part": None if found.part is None else _part(found.part),
    }


def _part(part: FoundPart) -> dict[str, Any]:
    return {
        "file": str(part.path),
        "joint": part.joint,
        "joints": list(part.joints),
        "fit": part.fit,
        "fit_of_best": part.fit_of_best,
    }


def _rows(ranked: Sequence[FoundSource]) -> list[dict[str, Any]]:
    return [
        {
            "file": str(each.path),
            "fits": each.fits,
            "fit": 1 - each.misfit,
            "certainty": each.certainty,
            "difference": each.difference,
            "is_part": each.is_part,
        }
        for each in ranked
    ]
