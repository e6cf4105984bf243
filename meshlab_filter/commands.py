"""The commands of `python -m meshlab_filter`: transfer between files, and scripts of filters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from meshlab_filter.batch import transfer_steps
from meshlab_filter.files import (
    FORMATS,
    SURFACES,
    TextureFiles,
    check_format,
    load_mesh,
    new_mesh_set,
    save_beside,
    texture_files,
)
from meshlab_filter.script import read_script, run_script_steps
from zoomout_core.batch import is_folder, planned, say_outcomes, write_report
from zoomout_core.command_options import (
    batch_options,
    in_place_option,
    match_options,
    start_arguments,
    threads_option,
    with_progress_bar,
)
from zoomout_core.matching.presets import DETAIL
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.outputs import check_output


@click.group()
@threads_option
def main() -> None:
    """Filters for mesh files, in every format that MeshLab reads."""


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
    **options: Any,
) -> None:
    """Transfer texture coordinates, colours and scalars from the mesh SOURCE to the meshes TARGETS.

    They may differ in pose, in triangles and in placement. A folder among TARGETS stands for the meshes in it.
    Textures are written beside the output. In an output folder each file is named after its target, and report.json
    says how each went; a target that fails leaves the others alone.

    The exit code is 0 if all were written, 1 if none was, and 3 if some were.
    """
    try:
        jobs = planned(source, targets, output, f".{ending}", SURFACES, check_format, in_place)
        preset = DETAIL[options["detail"]]
        matching = {name: value for name, value in start_arguments(**options).items() if name not in preset}
        steps = transfer_steps(source, jobs, in_place, candidate=candidate, detail=options["detail"], **matching)
        outcomes = with_progress_bar(steps)
        if is_folder(output):
            write_report(source, outcomes, Path(output))
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    say_outcomes(outcomes, output)


@main.command()
@click.argument("script", type=click.Path())
@click.argument("inputs", nargs=-1, required=True, type=click.Path())
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The mesh file to write.")
@in_place_option
def run(script: str, inputs: tuple[str, ...], output: str, in_place: bool) -> None:
    """Run SCRIPT, a .mlx file, on the meshes INPUTS, and write the mesh that is current in the end.

    The script may mix the filters of MeshLab and of this project. INPUTS are meshes 0, 1 and so on; the last is
    current.
    """
    try:
        check_output(output, [script, *inputs], in_place)
        read_script(script)
        ms = new_mesh_set()
        textures: TextureFiles = {}
        for path in inputs:
            textures |= texture_files(ms.mesh(load_mesh(ms, path)), path)
        reports = with_progress_bar(run_script_steps(ms, script))
        if ms.mesh_number() == 0:
            raise MeshError("No mesh is left to write: keep one.")
        save_beside(ms, Path(output), textures, {}, in_place)
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    for report in reports:
        for note in report.get("notes", ()):
            click.echo(f"Line {report['line']}, {report['name']}: {note}")
    click.echo(f"Written to {output}")
