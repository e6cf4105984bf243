# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout lods`: levels of detail with all data of a mesh."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from zoomout_core.assets.asset import UV, Asset
from zoomout_core.assets.files import (
    GLTF,
    WRITERS,
    check_avatar,
    check_compression,
    check_writable,
    inputs_of,
    read_asset,
    write_asset,
)
from zoomout_core.assets.given_levels import complete_levels
from zoomout_core.assets.level import Level
from zoomout_core.assets.lods import make_lods, with_fewer_weights, with_level_names
from zoomout_core.assets.stored_map import stored_map_of
from zoomout_core.assets.transfer_asset import KINDS
from zoomout_core.batch import check_folder, is_folder
from zoomout_core.cli.report import json_option
from zoomout_core.command_options import (
    FilePath,
    OptionError,
    compress_option,
    folders_option,
    progress_bar,
    refusals,
    tell,
)
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.messages import note_figures, note_lines
from zoomout_core.runtime.outputs import check_output, make_folder

RATIOS = "0.5,0.25,0.1"


@click.command()
@click.argument("mesh", metavar="MESH", type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(), help="The folder to write the levels to.")
@click.option(
    "--ratios",
    show_default=RATIOS,
    metavar="SHARE,SHARE",
    help="The share of vertices that each level keeps.",
)
@click.option(
    "--level",
    "given",
    multiple=True,
    metavar="FILE",
    type=FilePath(),
    help="A mesh made by hand to use as a level, instead of simplifying MESH, in its place and rest pose; repeatable.",
)
@click.option("--keep-uv", is_flag=True, help="Meshes of --level keep their own texture coordinates if they have any.")
@click.option("--max-weights", type=click.IntRange(min=1), help="Largest number of joints of a vertex, in all levels.")
@click.option(
    "--format",
    "ending",
    type=click.Choice([ending[1:] for ending in WRITERS]),
    default="glb",
    show_default=True,
    help="Format of the files.",
)
@click.option(
    "--keep-map", is_flag=True, help="Store the maps to MESH, so that `zoomout update` can update the levels."
)
@compress_option
@folders_option
@json_option
def lods(
    mesh: str,
    output: str,
    ratios: str | None,
    given: tuple[str, ...],
    keep_uv: bool,
    max_weights: int | None,
    ending: str,
    keep_map: bool,
    compression: str | None,
    folders: tuple[str, ...],
    as_json: bool,
) -> None:
    """Write levels of detail of MESH, with all of its data.

    MESH is decimated to each share of its vertices. Each level receives texture coordinates, colours, materials, morph
    targets, normals and skin weights from MESH itself, not from the level before, and keeps its joints and animations.
    Meshes of --level receive the same, in order of their triangle counts; their vertices and faces stay.
    The files are named after MESH, with _LOD0 for MESH itself, then _LOD1 and so on.
    """
    with refusals():
        _check_options(ratios, given, keep_uv, keep_map, ending)
        shares = [] if given else _read_ratios(ratios or RATIOS)
        given = tuple(dict.fromkeys(given))
        paths = _plan_files(output, Path(mesh).stem, ending, len(given or shares))
        for read in (mesh, *given):
            if Path(read).suffix.lower() in OF_BLENDER:
                raise MeshError(f"zoomout lods reads only the shape of {read}: export it as .glb.")
        inputs = inputs_of(mesh, *given, folders=folders)
        for path in paths if Path(output).is_dir() else [Path(output)]:
            check_output(path, inputs)
        asset = read_asset(mesh, folders)
        check_avatar(asset, paths[0])
        check_compression(paths[0], compression)
        check_writable(asset, mesh, f".{ending}")
        meshes = {each: read_asset(each, folders) for each in given}
        with progress_bar():
            if given:
                found = complete_levels(asset, meshes, max_weights, keep_uv)
                names, levels = list(found), list(found.values())
            else:
                names, levels = [], make_lods(asset, shares, max_weights)
        first = asset if max_weights is None else with_fewer_weights(asset, max_weights)
        kinds = tuple(kind for kind in KINDS if not (keep_uv and kind == UV))
        assets = [first, *(_with_map(each, asset, kinds, max_weights) if keep_map else each.asset for each in levels)]
        make_folder(Path(output))
        rows = []
        for number, (each, path) in enumerate(zip(assets, paths, strict=True)):
            left_out = write_asset(with_level_names(each, number), path, inputs, compression)
            notes = [*(levels[number - 1].notes if number else asset.notes), *left_out]
            rows.append(_figures(path, each, levels[number - 1] if number else None, notes))
            if number and names:
                rows[-1]["made_from"] = names[number - 1]
    if as_json:
        click.echo(json.dumps({"mesh": mesh, "levels": rows}, indent=1))
        return
    for row in rows:
        tell(_line(row))


def _plan_files(output: str, name: str, ending: str, count: int) -> list[Path]:
    """The files of a mesh and of a number of levels.

    Raises:
        MeshError: the output is not a folder.
        OutputError: a file is in the place of the folder.
    """
    if not is_folder(output):
        raise MeshError(f"{output} is a file, but there are {count + 1} levels: give a folder.")
    folder = Path(output)
    check_folder(folder)
    return [folder / f"{name}_LOD{number}.{ending}" for number in range(count + 1)]


def _check_options(ratios: str | None, given: tuple[str, ...], keep_uv: bool, keep_map: bool, ending: str) -> None:
    """Check that options do not contradict each other.

    Raises:
        OptionError: they do.
    """
    if given and ratios is not None:
        raise OptionError("--level and --ratios exclude each other: give one of them.")
    if keep_uv and not given:
        raise OptionError("--keep-uv is for meshes of --level: give these, or leave it out.")
    if keep_map and f".{ending}" not in GLTF:
        raise OptionError(f"--keep-map needs files in glTF: choose --format {' or '.join(e[1:] for e in GLTF)}.")


def _read_ratios(text: str) -> list[float]:
    """The shares of an option.

    Raises:
        OptionError: they are not numbers.
    """
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise OptionError(f"--ratios is {text!r}: give shares such as {RATIOS}, separated by commas.") from None


def _with_map(level: Level, asset: Asset, kinds: tuple[str, ...], max_weights: int | None) -> Asset:
    stored = stored_map_of(level.match, asset.surface, kinds, True, max_weights)
    return replace(level.asset, stored_map=stored)


def _figures(path: Path, asset: Asset, level: Level | None, notes: list[str]) -> dict[str, Any]:
    """The figures of a level, or of the mesh itself, in values that JSON can store."""
    figures = {
        "output": str(path),
        "vertices": len(asset.surface.vertices),
        "triangles": len(asset.surface.triangles),
        **note_figures(notes),
    }
    if level is not None:
        figures |= {
            "rest_error": level.rest_error,
            "posed_error": level.posed_error,
            "posed_geometry_error": level.posed_geometry_error,
        }
    return figures


def _line(row: dict[str, Any]) -> str:
    """The figures of a level in a line."""
    made = f" from {row['made_from']}" if "made_from" in row else ""
    line = f"{row['output']}{made}: {row['vertices']:,} vertices, {row['triangles']:,} triangles"
    if "rest_error" in row:
        line += f", mean error {row['rest_error']:.3%} of the extent at rest"
    if row.get("posed_error") is not None:
        line += f", {row['posed_error']:.3%} in poses ({row['posed_geometry_error']:.3%} with all weights)"
    return " ".join((f"{line}.", *note_lines(row["notes"])))
