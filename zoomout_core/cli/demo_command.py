# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout demo`."""

from __future__ import annotations

from pathlib import Path

import click

from zoomout_core.cli.report import json_option, say
from zoomout_core.command_options import FilePath, refusals
from zoomout_core.mesh.formats.blender_files import extension_module


@click.command()
@click.option(
    "-o", "--output", default="demo", show_default=True, type=FilePath(file_okay=False), help="Folder to write to."
)
@json_option
def demo(output: str, as_json: bool) -> None:
    """Run the demo in headless Blender.

    It builds, poses and remeshes a character, matches the two, transfers, and measures the result.
    """
    extension = extension_module("demo")
    if extension is None:
        raise click.ClickException("The demo needs the project's source and Blender as a module: run `make demo`.")
    module = extension.load()
    with refusals():
        report = module.run(Path(output))
    say(module.summary(report), report, as_json)
