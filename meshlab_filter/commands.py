# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands of `python -m meshlab_filter`: transfer between files, and scripts of filters."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

import meshlab_filter.filters  # noqa: F401, which enters them into the catalogue
from meshlab_filter.batch import transfer_files
from meshlab_filter.catalogue import meaning, print_filter_list, print_filter_parameter_list, search
from meshlab_filter.files import (
    FORMATS,
    SURFACES,
    TextureFiles,
    check_format,
    new_mesh_set,
    save_beside,
)
from meshlab_filter.project import files_of, load_inputs
from meshlab_filter.samples import write_samples
from meshlab_filter.script import read_script, run_script
from meshlab_filter.watch import Watch, watch
from zoomout_core.assets.files import inputs_of
from zoomout_core.batch import (
    FAILED,
    PARTLY,
    check_inputs_stay,
    figures_of,
    is_folder,
    plan,
    say_outcomes,
    write_report,
)
from zoomout_core.command_options import (
    FilePath,
    batch_options,
    files_of_options,
    in_place_option,
    match_options,
    progress_bar,
    read_options,
    refusals,
    table_option,
    tell,
)
from zoomout_core.global_options import quiet_option, threads_option
from zoomout_core.matching.option_table import OPTIONS
from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import NO_MEMORY, message_of, note_lines
from zoomout_core.runtime.interrupts import INTERRUPTED
from zoomout_core.runtime.outputs import check_output


@click.group()
@click.version_option(package_name="zoomout-core")
@threads_option
@quiet_option
def main() -> None:
    """Filters for mesh files in every format that MeshLab reads."""


@main.command("list")
def list_command() -> None:
    """List this project's filters with their descriptions."""
    print_filter_list()


@main.command("search")
@click.argument("words", nargs=-1, required=True)
def search_command(words: tuple[str, ...]) -> None:
    """List the filters of this project and of MeshLab that contain WORDS.

    The exit code is 1 if no filter does.
    """
    with refusals():
        if not search(" ".join(words)):
            raise MeshError(f"No filter name contains {' and '.join(words)}: try other words, or fewer.")
        print_filter_list(" ".join(words))


@main.command()
@click.argument("name", metavar="FILTER")
def describe(name: str) -> None:
    """Describe FILTER and its parameters."""
    with refusals():
        if meaning(name):
            click.echo(meaning(name))
        print_filter_parameter_list(name)


@main.command()
@click.argument("folder", type=FilePath(file_okay=False, path_type=Path))
def samples(folder: Path) -> None:
    """Write the sample meshes of the guide's recipes into the new folder FOLDER."""
    with refusals():
        paths = write_samples(folder)
    tell(f"Written to {folder}: {', '.join(str(path.relative_to(folder)) for path in paths)}")


@main.command()
@batch_options(tuple(FORMATS), "ply")
@match_options
def transfer(
    source: str,
    targets: tuple[str, ...],
    output: str,
    ending: str,
    candidate: int,
    in_place: bool,
    force: bool,
    **options: Any,
) -> None:
    """Transfer texture coordinates, colours and scalars from the mesh SOURCE to the meshes TARGETS.

    Meshes may differ in pose, topology and position. A folder among TARGETS stands for all meshes in it.
    Textures are written next to the output. In an output folder each file is named after its target, and report.json
    describes all results; a target that fails does not stop the others.

    The exit code is 0 if all were written, 1 if none was, and 3 if some were.
    """
    with refusals():
        jobs = plan(source, targets, output, f".{ending}", SURFACES, check_format, in_place)
        if not in_place:
            files = [source, *(str(job.target) for job in jobs), *files_of_options(options)]
            check_inputs_stay(jobs, output, inputs_of(*files))
        matching = read_options(**options)
        with progress_bar():
            outcomes = transfer_files(source, jobs, in_place, force, candidate=candidate, **matching)
        if is_folder(output):
            given = {"candidate": candidate, "force": force, **options}
            write_report(figures_of(source, outcomes, given), Path(output))
    say_outcomes(outcomes, output)


@main.command()
@click.argument("script", type=FilePath())
@click.argument("inputs", nargs=-1, required=True, type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(dir_okay=False), help="The mesh file to write.")
@in_place_option
def run(script: str, inputs: tuple[str, ...], output: str, in_place: bool) -> None:
    """Run SCRIPT, a .mlx file, on the meshes INPUTS, and write the mesh that is current at the end.

    The script may use the filters of MeshLab and of this project. INPUTS are meshes 0, 1 and so on; the last is
    current. A MeshLab project (.mlp) among them stands for its meshes with their transforms.
    """
    with refusals():
        kept = inputs_of(*(file for path in inputs for file in files_of(path)))
        check_output(output, [script, *kept], in_place)
        read_script(script)
        ms = new_mesh_set()
        textures: TextureFiles = {}
        for path in inputs:
            textures |= load_inputs(ms, path)
        with progress_bar():
            reports = run_script(ms, script)
        if ms.mesh_number() == 0:
            raise MeshError("The script leaves no mesh to write: keep at least one.")
        save_beside(ms, Path(output), textures, {}, in_place, kept)
    for report in reports:
        for note in note_lines(report.get("notes", ())):
            tell(f"Line {report['line']}, {report['name']}: {note}")
    tell(f"Written to {output}")


@main.command("watch")
@click.argument("folder", type=FilePath(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--source",
    type=FilePath(exists=True, dir_okay=False, path_type=Path),
    help="Transfer attributes from this mesh to every mesh saved in FOLDER.",
)
@click.option(
    "--script",
    type=FilePath(exists=True, dir_okay=False, path_type=Path),
    help="Run this .mlx file on every saved mesh and project, instead of a transfer.",
)
@table_option(OPTIONS["detail"])
@click.option(
    "--interval",
    type=click.FloatRange(0.1),
    default=1.0,
    show_default=True,
    help="Seconds between checks of the folder.",
)
@click.option("--once", is_flag=True, help="Process existing files, then exit.")
def watch_command(
    folder: Path, source: Path | None, script: Path | None, detail: str, interval: float, once: bool
) -> None:
    """Process each file that MeshLab or another program saves in FOLDER, and write the results next to it.

    The first mesh of a project (.mlp) is the source of the others: their results are written to
    NAME_zoomout.ply, and PROJECT_zoomout.mlp opens them all. Other meshes need --source or --script. Stop with Ctrl-C.

    With --once the exit code is 0 if all succeeded, 1 if all failed, and 3 otherwise.
    """
    work = Watch(folder, source, script, detail)
    outcomes: list[bool] = []

    def process(path: Path) -> None:
        tell(f"{path.name} was saved.")
        try:
            with progress_bar():
                lines = work.process(path)
            for line in lines:
                tell(f"  {line}")
        except (ValueError, OSError, MemoryError) as error:
            click.echo(f"{path.name}: failed. {message_of(error) or NO_MEMORY}", err=True)
            outcomes.append(False)
        else:
            outcomes.append(True)

    try:
        with refusals():
            new_mesh_set()
            if script is not None:
                read_script(script)
            if not once:
                tell(f"Watching {folder}; press Ctrl-C to stop.")
            for _ in watch(work, process, interval, once):
                pass
    except KeyboardInterrupt:
        click.echo(f"\nNo longer watching {folder}: {sum(outcomes)} files were worked on.", err=True)
        sys.exit(INTERRUPTED)
    if not all(outcomes):
        sys.exit(PARTLY if any(outcomes) else FAILED)


for command in (samples, transfer, run, watch_command):
    quiet_option(command)
