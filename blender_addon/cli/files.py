# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands `surface`, `assets`, `library`, `carry`, `faces` and `outfits`, which open files."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.drawing import encode_png
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.messages import message_of
from zoomout_core.outfits.command import dress_files, find_avatars
from zoomout_core.runtime.outputs import atomic_write, make_folder

from ..properties.dress import DressOptions
from ..properties.transfer import BindOptions, BlendOptions
from ..scene.selection import asset_libraries
from ..services.dressing.read import Dressing
from ..services.expressions import Review, has_keys, review_expressions
from ..services.key_names import rename_shape_keys
from ..services.library import read_assets
from ..services.outfits import ENDINGS, BlenderFiles
from ..services.targets import Outcome
from ..services.transfer_files import FileTransfer, read_file, transfer_files
from ..storage.stored_match import StoredMatch
from ..translations import user_language
from .property_arguments import as_in_sidebar


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


def assets(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Write each asset of a file as a surface to a folder, and report on each by name.

    Raises:
        MeshError: the file cannot be used.
        OutputError: a surface could not be written.
    """
    make_folder(Path(options.folder))
    entries: dict[str, Any] = {}
    for number, (name, surface) in enumerate(read_assets(context, options.file).items()):
        entries[name] = {"error": surface} if isinstance(surface, str) else {"file": f"{number}.ply"}
        if isinstance(surface, zo.Surface):
            write_shape(surface, Path(options.folder, entries[name]["file"]))
    return entries


def library(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Prepare folders of characters for a search, and report on each.

    Raises:
        MeshError: no folder is given, and no asset library of the Preferences exists.
    """
    folders = options.folders or asset_libraries(context)
    if not folders:
        raise zo.MeshError("The Preferences have no asset library: give the folder of one.")
    entries: dict[str, Any] = {}
    for folder in folders:
        try:
            prepared = zo.Library(folder, options.index, bpy.app.binary_path or None).prepare()
        except (ValueError, OSError) as error:
            entries[folder] = {"error": message_of(error)}
            continue
        skipped = {str(path): f"{path} was skipped. {sentence}" for path, sentence in prepared.failures.items()}
        entries[folder] = {"assets": prepared.assets, "new": prepared.new, "left_out": skipped}
        if prepared.assets:
            entries[folder]["done"] = [f"{prepared.assets} characters, {prepared.new} of them new"]
        else:
            entries[folder]["error"] = f"{folder} contains no character that can be used."
    return entries


def carry(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Transfer from one file to another, and report on each target by name.

    Raises:
        MeshError: a file cannot be used, or the map belongs to other files.
    """
    binding = BindOptions.how_to_bind(as_in_sidebar(options, BindOptions))
    transfer = replace(
        _file_transfer(options, options.data),
        settings=BlendOptions.settings(as_in_sidebar(options, BlendOptions)),
        binding=replace(binding, move_rig=options.move_rig) if options.bind or options.move_rig else None,
    )
    outcome = transfer_files(context, transfer)
    return outcome.done | {name: {"error": reason} for name, reason in outcome.failed.items()}


def _file_transfer(options: argparse.Namespace, data: Collection[str]) -> FileTransfer:
    """The transfer between two files that options describe, with default settings."""
    return FileTransfer(
        options.source,
        options.target,
        options.save,
        data,
        in_place=options.in_place,
        map_file=options.map or "",
        detail=options.detail,
        force=options.force,
    )


def faces(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Transfer the shape keys of one file to another, draw them all, and report on each target by name.

    A target whose source has no shape keys, such as an eye, is drawn without.

    Raises:
        MeshError: a file cannot be used, or the map belongs to other files.
        OutputError: the sheet could not be written.
    """
    reviews: list[Review] = []
    without: set[str] = set()

    def review(sources: Sequence[str], matches: Mapping[str, tuple[str, StoredMatch]], outcome: Outcome[Any]) -> None:
        for name in outcome.failed:
            first, match = matches[name]
            if not any(has_keys(context, source) for source in (first, *match.others)):
                without.add(name)
        if outcome.done:
            reviews.append(review_expressions(context, sources, matches))

    outcome = transfer_files(context, _file_transfer(options, ("shape_keys",)), review)
    failed = {name: reason for name, reason in outcome.failed.items() if name not in without or not outcome.done}
    entries = outcome.done | {name: {"error": reason} for name, reason in failed.items()}
    for found in reviews:
        with atomic_write(options.sheet) as part:
            part.write_bytes(encode_png(found.sheet))
        for name in outcome.done:
            entries[name]["stretched_by_keys"] = found.stretched[name]
            entries[name]["intersecting_by_keys"] = found.intersecting[name]
    if options.key_names:
        for name in outcome.done:
            note = rename_shape_keys(context, context.scene.objects[name], options.key_names)
            entries[name]["notes"] = [*entries[name]["notes"], note]
    return entries


def outfits(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Dress avatars in files, and report on each outfit on an avatar.

    Raises:
        MeshError: there is no file, or no outfit can be put on any avatar.
        OutputError: the results could not be written.
    """
    outfits, avatars = find_avatars(options.outfits, options.avatars, options.output, ENDINGS)
    dressing = Dressing(**DressOptions.dress_options(as_in_sidebar(options, DressOptions)))
    ending = f".{options.format}" if options.format else ""
    files = BlenderFiles(context, dressing, tuple(options.body), options.force, ending)
    match_options = MatchOptions(**resolve_detail(options.detail))
    locale = options.language or user_language("use_translate_interface")
    result = dress_files(
        outfits, avatars, options.output, files, match_options, resume=not options.restart, locale=locale
    )
    return {
        str(name): {"verdict": worn.verdict._asdict(), "file": worn.output, "notes": list(worn.notes)}
        for name, worn in result.worn.items()
    } | {name: {"error": reason} for name, reason in result.failures.items()}
