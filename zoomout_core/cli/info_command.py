# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout info`: the content of a mesh file."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import click
import numpy as np

from zoomout_core.assets.asset import MATERIALS, SHAPE_KEYS, Asset
from zoomout_core.assets.files import read_asset
from zoomout_core.assets.gltf.avatars import read_avatar
from zoomout_core.cli.report import json_option, say
from zoomout_core.command_options import FilePath, folders_option, refusals
from zoomout_core.mesh.triangles import border_edges
from zoomout_core.messages import note_figures, note_lines


@click.command()
@click.argument("mesh", type=FilePath())
@folders_option
@json_option
def info(mesh: str, folders: tuple[str, ...], as_json: bool) -> None:
    """Show the contents of MESH that `zoomout transfer` can read."""
    with refusals():
        asset = read_asset(mesh, folders)
    figures = _figures(asset)
    say(_lines(figures), figures, as_json)


def _figures(asset: Asset) -> dict[str, Any]:
    surface = asset.surface
    used = surface.components[surface.components >= 0]
    border = border_edges(surface.working.triangles)
    keys, skin = asset.find(SHAPE_KEYS), asset.skin
    avatar = read_avatar(asset.document)
    return {
        "vertices": len(surface.vertices),
        "faces": len(surface.face_start) - 1,
        "triangles": len(surface.triangles),
        "parts": int(used.max(initial=-1)) + 1,
        "border_edges": len(border),
        "area": surface.area,
        "size": np.ptp(surface.vertices[surface.corner_vertex], axis=0).tolist(),
        "attributes": [each.name for each in asset.attributes if each.name not in (SHAPE_KEYS, MATERIALS)],
        "materials": [material.name for material in asset.materials],
        "shape_keys": [] if keys is None else list(keys.labels),
        "joints": [] if skin is None else list(skin.names),
        "animations": [] if asset.document is None else [each.name for each in asset.document.gltf.animations],
        "avatar": None if avatar is None else asdict(avatar),
        **note_figures(asset.notes),
    }


def _lines(figures: dict[str, Any]) -> list[str]:
    size = " x ".join(f"{extent:.4g}" for extent in figures["size"])
    lines = [
        f"{figures['vertices']:,} vertices, {figures['faces']:,} faces ({figures['triangles']:,} triangles), "
        f"loose parts: {figures['parts']:,}, border edges: {figures['border_edges']:,}.",
        f"Size {size}, area {figures['area']:.4g}.",
    ]
    for name in ("attributes", "materials", "shape_keys", "joints", "animations"):
        if figures[name]:
            words = name.replace("_", " ").capitalize()
            lines.append(f"{words} ({len(figures[name])}): {', '.join(map(str, figures[name]))}.")
    return [
        *lines,
        *([] if figures["avatar"] is None else _avatar_lines(figures["avatar"])),
        *note_lines(figures["notes"]),
    ]


def _avatar_lines(avatar: dict[str, Any]) -> list[str]:
    by = f" by {', '.join(avatar['authors'])}" if avatar["authors"] else ""
    words = {True: "yes", False: "no"}
    terms = [f"{term} {words.get(value, value)}" for term, value in avatar["licence"].items()]
    bones = [f"{bone} ({node})" for bone, node in avatar["bones"].items()]
    springs = [f"{name} ({count} joints)" for name, count in avatar["springs"]]
    return [
        f"Avatar of VRM {avatar['version']}: {avatar['title'] or 'unnamed'}{by}.",
        *(
            f"{what} ({len(items)}): {', '.join(items)}."
            for what, items in (
                ("Licence", terms),
                ("Humanoid bones", bones),
                ("Expressions", avatar["expressions"]),
                ("Spring chains", springs),
            )
            if items
        ),
    ]
