# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout transfer`: from one mesh file to another, without Blender and without MeshLab."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from zoomout_core.assets.asset import MATERIALS, SHAPE_KEYS, WEIGHTS, Asset
from zoomout_core.assets.files import (
    GLTF,
    MESHES,
    WRITERS,
    check_avatar,
    check_compression,
    check_format,
    check_siblings,
    check_writable,
    inputs_of,
    read_asset,
    write_asset,
)
from zoomout_core.assets.key_names import rename_keys
from zoomout_core.assets.part_names import mask_of_parts, parts_of
from zoomout_core.assets.stored_map import stored_map_of
from zoomout_core.assets.transfer_asset import KINDS, SHAPES, base_of, select_data, transfer_asset, without_weights
from zoomout_core.batch import (
    Job,
    check_inputs_stay,
    plan,
    report_outcomes,
    run_batch,
)
from zoomout_core.cli.report import json_option, match_figures, match_lines, match_notes
from zoomout_core.command_options import (
    OptionError,
    batch_options,
    compress_option,
    files_of_options,
    folders_option,
    match_options,
    refusals,
    start_arguments,
)
from zoomout_core.map_files import keep_map, save_match
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.report.verdict import check_verdict, select_notes
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.messages import note_figures, note_lines
from zoomout_core.runtime.outputs import make_folder
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer.keys.key_table import CONVENTIONS

# Fraction of the progress at the end of matching.
MATCHED = 0.8


@dataclass(frozen=True)
class _Choices:
    """Options of the command for each target, as its help describes them."""

    kinds: list[str]
    shape: str
    move_rig: bool
    only: tuple[str, ...]
    key_names: str | None
    keep_map: bool
    compress: str | None
    candidate: int
    force: bool


@click.command()
@batch_options(tuple(WRITERS), "glb")
@click.option(
    "--kinds",
    default=",".join(kind.replace(" ", "-") for kind in KINDS[:-1]),
    show_default=True,
    metavar="KIND,KIND",
    help=f"Data to transfer: {', '.join(kind.replace(' ', '-') for kind in KINDS)}.",
)
@click.option(
    "--shape",
    type=click.Choice([each.replace(" ", "-") for each in SHAPES]),
    default=SHAPES[0],
    show_default=True,
    help="With skin weights: move TARGET to the rest pose if it is in another pose, always, or never.",
)
@click.option(
    "--move-rig",
    is_flag=True,
    help="Move the joints of SOURCE into TARGET, which keeps its own size and build. With --only, those that move the "
    "part are added to the joints of TARGET.",
)
@click.option(
    "--only",
    multiple=True,
    metavar="PATTERN",
    help="Transfer only to these joints of TARGET with those below them, or meshes, such as 'Head*'; all other data "
    "stay, as do the joints and, without --move-rig, their weights. May be repeated.",
)
@click.option(
    "--key-names",
    type=click.Choice(list(CONVENTIONS)),
    help="Rename the morph targets to a convention of expression keys, add those that are sums of others, and list "
    "those that are missing.",
)
@click.option(
    "--keep-map",
    is_flag=True,
    help="Store the map in the glTF file, 16 bytes for each vertex, so that `zoomout update` can transfer later "
    "changes of SOURCE to it.",
)
@compress_option
@folders_option
@json_option
@match_options
def transfer(
    source: str,
    targets: tuple[str, ...],
    output: str,
    ending: str,
    in_place: bool,
    kinds: str,
    shape: str,
    move_rig: bool,
    only: tuple[str, ...],
    key_names: str | None,
    keep_map: bool,
    candidate: int,
    force: bool,
    compression: str | None,
    folders: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Transfer the data of SOURCE to other meshes.

    TARGETS may differ from SOURCE in pose, triangles and placement. A glTF or VRM source provides texture coordinates,
    colours, materials with their images, morph targets, and skin weights with their joints and animations, so that a
    target moves as SOURCE does. OBJ provides texture coordinates, colours and materials, PLY texture coordinates and
    colours. Other formats provide only a shape.

    Several sources may share a target: transfer the body first, and then, from another source, --only the head; with
    --move-rig also the joints of its face, below the head of the first.

    A folder among TARGETS stands for the meshes in it. In an output folder each file is named after its target, and
    report.json has the result of each; a target that fails does not affect the others.

    The exit code is 0 if all were written, 1 if none was, and 3 if some were.
    """
    with refusals():
        wanted = check_kinds(kinds)
        if Path(source).suffix.lower() in OF_BLENDER:
            raise MeshError(
                f"This command reads only the shape of {source}: use `zoomout collection` with --template and "
                "--transfer, or `blender --command zoomout carry`."
            )
        jobs = plan(source, targets, output, f".{ending}", MESHES, check_format, in_place)
        files = [source, *(str(job.target) for job in jobs), *files_of_options(options)]
        inputs = [] if in_place else inputs_of(*files, folders=folders)
        check_inputs_stay(jobs, output, inputs)
        for job in jobs:
            check_siblings(job.output, inputs)
        check_compression(jobs[0].output, compression)
        if only and not move_rig:
            wanted = without_weights(wanted)
        if only and keep_map:
            raise OptionError("--only works without --keep-map, which is for a single source.")
        arguments, asset = start_arguments(**options), read_asset(source, folders)
        choices = _Choices(wanted, shape, move_rig, only, key_names, keep_map, compression, candidate, force)
        _check_choices(choices, asset, source, jobs[0].output.suffix)
        given = {**asdict(choices), "folders": folders, **options}
        run = partial(_run_job, asset, choices, arguments, folders, inputs)
        outcomes, figures = run_batch(source, jobs, run, given, output)
    report_outcomes(outcomes, figures, output, as_json)


def check_kinds(kinds: str) -> list[str]:
    """Read the kinds that an option names.

    Raises:
        OptionError: there are none, or some cannot be transferred.
    """
    chosen = [kind.strip().lower().replace("-", " ") for kind in kinds.split(",") if kind.strip()]
    unknown = [kind for kind in chosen if kind not in KINDS]
    if unknown or not chosen:
        known = ", ".join(kind.replace(" ", "-") for kind in KINDS)
        raise OptionError(f"--kinds is {kinds!r}: choose from {known}, separated by commas.")
    return chosen


def check_source(source: Asset, path: str, kinds: list[str], ending: str) -> None:
    """Check before the first match that a source has the data, and that it can be written.

    Raises:
        MeshError: it has none, or it cannot be written.
    """
    chosen, skin = select_data(source, kinds)
    trial = replace(source, attributes=tuple(chosen), skin=skin)
    if MATERIALS not in kinds and skin is None:
        trial = replace(trial, materials=(), document=None)
    check_writable(trial, path, ending)


def check_moved_rig(source: Asset, path: str, kinds: list[str]) -> None:
    """Check before the first match that a source has joints to move.

    Raises:
        MeshError: it has none.
    """
    if WEIGHTS not in kinds or source.skin is None:
        raise MeshError(
            f"--move-rig has no joints of {path} to move: leave it out, or choose a rigged glTF source and "
            "--kinds with weights."
        )


def _check_choices(choices: _Choices, source: Asset, path: str, ending: str) -> None:
    """Check before the first match that a source has the data that the options are about.

    Raises:
        MeshError: it lacks them, or they cannot be written.
        OptionError: a map cannot be stored in such a file.
    """
    check_source(source, path, choices.kinds, ending)
    if choices.move_rig:
        check_moved_rig(source, path, choices.kinds)
    if choices.key_names and (SHAPE_KEYS not in choices.kinds or source.find(SHAPE_KEYS) is None):
        raise MeshError(
            f"--key-names has no morph targets of {path} to rename: leave it out, or choose a source and --kinds "
            "with shape-keys."
        )
    if choices.keep_map and (choices.key_names or ending.lower() not in GLTF):
        raise OptionError(
            "--keep-map needs an output in glTF with the key names of SOURCE: leave out --key-names, and write "
            f"{' or '.join(GLTF)} files."
        )


def _run_job(
    source: Asset,
    choices: _Choices,
    arguments: dict[str, Any],
    folders: Sequence[str],
    inputs: Sequence[Path],
    job: Job,
    report: dict[str, Any],
) -> list[str]:
    """Transfer to one target, and write it.

    Args:
        source: the source.
        choices: options of the command.
        arguments: options of the match.
        folders: further folders in which buffers and images may be.
        inputs: files that must not be replaced.
        job: the target and the output.
        report: filled in for `report.json`.

    Returns:
        The lines of the outcome.
    """
    target = read_asset(job.target, folders)
    check_writable(target, job.target, job.output.suffix)
    check_avatar(target if choices.only else base_of(source, target, choices.kinds), job.output)
    mask = mask_of_parts(target, choices.only) if choices.only else None
    with portion(0.0, MATCHED):
        result = match(source.surface, target.surface, **arguments)
    if choices.candidate:
        with portion(MATCHED, MATCHED):
            result = result.use(choices.candidate)
    parts = parts_of(source)
    notes = [*source.notes, *target.notes, *match_notes(result, parts)]
    report |= match_figures(result, parts) | note_figures(notes)
    check_verdict(result.verdict, choices.force, len(result.candidates))
    with keep_map(partial(save_match, result), job.output):
        make_folder(job.output.parent)
        with portion(MATCHED, 1.0):
            shape = choices.shape.replace("-", " ")
            made = transfer_asset(source, target, result, choices.kinds, shape, move_rig=choices.move_rig, mask=mask)
        written, named = made.asset, list[str]()
        if choices.keep_map:
            written = replace(
                written, stored_map=stored_map_of(made.mapped or result, source.surface, tuple(choices.kinds))
            )
        if choices.key_names:
            written, keys, named = rename_keys(made.asset, choices.key_names)
            report["key_names"] = asdict(keys)
        left_out = write_asset(written, job.output, inputs, choices.compress)
    received = [*made.received, *(["skin weights"] if WEIGHTS in choices.kinds and source.skin is not None else [])]
    notes = [*report["notes"], *made.notes, *named, *left_out]
    report |= {"transferred": received, **note_figures(notes)}
    if choices.move_rig:
        report["motions"] = [asdict(each) for each in made.motions]
    return [
        f"Transferred: {', '.join(received)}.",
        *match_lines(result, parts),
        *note_lines(select_notes(notes, result.verdict)),
    ]
