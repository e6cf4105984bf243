# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout library`: prepare a folder of characters for `zoomout find`."""

from __future__ import annotations

import sys

import click

from zoomout_core.batch import FAILED, PARTLY
from zoomout_core.cli.report import json_option, say
from zoomout_core.command_options import FilePath, progress_bar, refusals
from zoomout_core.library.library import INDEX, Library
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import PROGRAM


@click.command()
@click.argument("folder", type=FilePath())
@click.option("--index", type=FilePath(file_okay=False), help=f"Folder of the index (default: {INDEX} in FOLDER).")
@click.option("--blender", metavar="PROGRAM", help=f"Blender's, for .blend and .fbx (default: {PROGRAM}, or blender).")
@json_option
def library(folder: str, index: str | None, blender: str | None, as_json: bool) -> None:
    """Prepare the characters in FOLDER for `zoomout find`.

    Its subfolders are included. Files that are prepared already are skipped unless they changed; an
    interrupted preparation resumes where it stopped. Blender reads .blend and .fbx.
    """
    with refusals():
        with progress_bar():
            report = Library(folder, index, blender).prepare()
        if not (report.assets or report.failures):
            raise MeshError(f"{folder} and its subfolders contain no meshes: check the path.")
    for path, sentence in report.failures.items():
        click.echo(f"{path} was skipped. {sentence}", err=True)
    lines = [f"Characters: {report.assets}, {report.new} of them new. Files skipped: {len(report.failures)}."]
    figures = {
        "folder": folder,
        "assets": report.assets,
        "new": report.new,
        "failures": [{"file": str(path), "error": sentence} for path, sentence in report.failures.items()],
    }
    say(lines, figures, as_json)
    if report.failures:
        sys.exit(PARTLY if report.assets else FAILED)
