# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout`."""

import click

from zoomout_core.cli.group import CommandGroup
from zoomout_core.global_options import quiet_option, threads_option

# The command NAME is in the module NAME_command. The help shows these summaries without importing the modules.
SUMMARIES = {
    "match": "Find the point on SOURCE for each vertex of TARGET.",
    "transfer": "Transfer the data of SOURCE to other meshes.",
    "lods": "Write levels of detail of MESH, with all of its data.",
    "update": "Transfer changes of a source to files made from it.",
    "landmarks": "Place the landmarks of TEMPLATE on other meshes.",
    "collection": "Match many shapes, and make their maps agree.",
    "outfits": "Dress avatars in the clothes of others.",
    "library": "Prepare the characters in FOLDER for `zoomout find`.",
    "find": "Find the characters of a library that fit TARGETS.",
    "symmetry": "Find the symmetries of MESH in any pose.",
    "evaluate": "Measure MAP: flipped area, coverage, distortion and error.",
    "info": "Show the contents of MESH that `zoomout transfer` can read.",
    "sample": "Write a character and a scan of it into FOLDER.",
    "demo": "Run the demo in headless Blender.",
}


@click.group(cls=CommandGroup, summaries=SUMMARIES)
@click.version_option(package_name="zoomout-core")
@threads_option
@quiet_option
def main() -> None:
    """Dense correspondence between surfaces, whatever their pose and topology."""
