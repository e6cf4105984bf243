# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout`."""

import click

from zoomout_core.cli.collection_command import collection
from zoomout_core.cli.demo_command import demo
from zoomout_core.cli.evaluate_command import evaluate
from zoomout_core.cli.group import CommandGroup
from zoomout_core.cli.info_command import info
from zoomout_core.cli.landmarks_command import landmarks
from zoomout_core.cli.match_command import match
from zoomout_core.cli.sample_command import sample
from zoomout_core.cli.symmetry_command import symmetry
from zoomout_core.cli.transfer_command import transfer
from zoomout_core.command_options import quiet_option, threads_option


@click.group(cls=CommandGroup)
@click.version_option(package_name="zoomout-core")
@threads_option
@quiet_option
def main() -> None:
    """Dense correspondence between surfaces, whatever their pose and topology."""


for command in (match, transfer, landmarks, collection, symmetry, evaluate, info, sample, demo):
    main.add_command(quiet_option(command))
