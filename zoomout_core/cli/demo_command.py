# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout demo`."""

from __future__ import annotations

from pathlib import Path

import click

from zoomout_core.cli.report import json_option, say
from zoomout_core.mesh.surface import MeshError


@click.command()
@click.option(
    "-o", "--output", default="demo", show_default=True, type=click.Path(file_okay=False), help="Folder to write to."
)
@json_option
def demo(output: str, as_json: bool) -> None:
    """Build, pose, match and transfer a character in headless Blender, and measure it against the truth."""
    try:
        from blender_addon.demo import run, summary
    except ModuleNotFoundError as error:
        if error.name == "blender_addon":
            raise click.ClickException("The demo is part of the project's source: run `make demo` there.") from None
        raise click.ClickException(f"The demo needs Blender as a module ({error}): pip install bpy.") from None
    try:
        report = run(Path(output))
    except (MeshError, OSError) as error:
        raise click.ClickException(str(error)) from None
    say(summary(report), report, as_json)
