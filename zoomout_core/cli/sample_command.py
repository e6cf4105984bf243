# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout sample`: meshes to try the others on."""

from __future__ import annotations

import click

from zoomout_core.cli.report import json_option, say
from zoomout_core.command_options import FilePath, refusals
from zoomout_core.samples import write_samples


@click.command()
@click.argument("folder", type=FilePath(file_okay=False))
@json_option
def sample(folder: str, as_json: bool) -> None:
    """Write a character and a scan of it into FOLDER.

    Try the other commands on them.

    The character has texture coordinates, materials, colours, joints and an animation. The scan has another pose and
    other triangles, and no data. The file truth.txt lists corresponding vertices of both, for `zoomout evaluate`.
    """
    with refusals():
        files = write_samples(folder)
    names = [str(file) for file in files]
    say([f"Wrote {', '.join(names[:-1])} and {names[-1]}."], {"files": names}, as_json)
