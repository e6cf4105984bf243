# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands `surface` and `carry`, which open files."""

from __future__ import annotations

import argparse
from typing import Any

from bpy.types import Context

import zoomout_core as zo
from zoomout_core.mesh.files import write_shape

from ..properties.transfer import BindOptions, BlendOptions
from ..services.carry import carry as carry_file
from ..services.carry import read_file
from .arguments import as_in_sidebar


def surface(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Write the visible meshes of a file as one surface, and report on each object by name.

    Raises:
        MeshError: the file cannot be used.
        OutputError: the surface could not be written.
    """
    read = read_file(context, options.file, options.role)
    joined = zo.Surface.joined(list(read.values()))
    # With Blender's triangles, so that a map by triangles can be read there.
    write_shape(zo.Surface(joined.vertices, joined.triangles), options.save)
    return {
        name: {"vertices": len(each.vertices), "faces": len(each.face_start) - 1, "triangles": len(each.triangles)}
        for name, each in read.items()
    }


def carry(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Transfer from one file to another, and report on each target by name.

    Raises:
        MeshError: a file cannot be used, or the map belongs to other files.
    """
    outcome = carry_file(
        context,
        options.source,
        options.target,
        options.save,
        options.data,
        BlendOptions.settings(as_in_sidebar(options, BlendOptions)),
        BindOptions.how_to_bind(as_in_sidebar(options, BindOptions)) if options.bind else None,
        options.map,
        options.detail,
        options.in_place,
    )
    return outcome.done | {name: {"error": reason} for name, reason in outcome.failed.items()}
