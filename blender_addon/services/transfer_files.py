# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer the data of all visible meshes in one file to those in another."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import bpy
from bpy.types import Context, Depsgraph, Object

import zoomout_core as zo
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.mesh.formats.blender_files import split_asset
from zoomout_core.messages import warning
from zoomout_core.runtime.outputs import check_output, is_same_file

from .. import mesh_data
from ..adapters import DEFAULT, Binding, Settings
from ..jobs import Work, run
from ..scene.files import Brought, keep_as_blend, open_scene, shown_meshes
from ..scene.pair import find_mesh, fingerprint_source, fingerprint_target
from ..storage import stored_candidates, stored_match
from .matching.collection_match import check_verdicts, prepare_parts
from .matching.joined_match import Parts
from .targets import Outcome, Write, each_target
from .transfer import prepare_transfer

# Looks at the result, from the names of the sources, and the name of the first source and the match of each target.
Review: TypeAlias = Callable[[Sequence[str], Mapping[str, tuple[str, stored_match.StoredMatch]], Outcome[Any]], None]

# Ways to read the objects of a file: as sources, by their evaluated meshes, or as targets, by their own meshes.
ROLES: Mapping[str, Callable[[Object, Depsgraph], zo.Surface]] = {
    "source": mesh_data.read_source_surface,
    "target": mesh_data.read_target_surface,
}


def read_file(context: Context, path: str, role: str) -> dict[str, zo.Surface]:
    """Open a file, and read its visible meshes, in world space.

    Args:
        context: Blender's.
        path: path of a file that Blender can open or import.
        role: a key of `ROLES`.

    Returns:
        Surfaces by the names of the objects; maps refer to them joined in this order.

    Raises:
        MeshError: the file cannot be opened, or has no visible mesh.
    """
    open_scene(context, path)
    names = shown_meshes(context.view_layer.objects)
    if not names:
        raise zo.MeshError(
            f"{path} has no visible mesh with faces: make one visible, or convert its objects to meshes."
        )
    return {name: ROLES[role](find_mesh(context, name), context.evaluated_depsgraph_get()) for name in names}


@dataclass(frozen=True)
class FileTransfer:
    """A transfer from the meshes of one file to those of another.

    Attributes:
        source: the file with the data, or an asset in a .blend file, see `split_asset`.
        target: the file that receives it.
        output: the file that will be written, which the target's file must not refer to; empty if none.
        in_place: whether the output may overwrite a file that is read.
        data: the kinds of data to transfer.
        settings: how to transfer them.
        binding: how to bind targets to the armatures of their sources, if any; None not to bind them.
        map_file: file with the map; empty to match the files now.
        detail: detail of that match, one of `DETAIL`.
        force: whether to transfer along a match that is probably wrong.
    """

    source: str
    target: str
    output: str
    data: Collection[str]
    in_place: bool = False
    settings: Settings = DEFAULT
    binding: Binding | None = None
    map_file: str = ""
    detail: str = "balanced"
    force: bool = False


def transfer_files(context: Context, transfer: FileTransfer, review: Review | None = None) -> Outcome[dict[str, Any]]:
    """Transfer the data of one file's meshes to those of another file, which is open afterwards.

    Data-blocks from the source's file are removed again, except those that the targets now use, such as materials and
    the armature that they are bound to.

    Args:
        context: Blender's.
        transfer: the files, the data and the match.
        review: called after the transfer, while the objects of both files are in the scene.

    Returns:
        Reports by the names of the targets, see `stored_report`.

    Raises:
        MeshError: a file cannot be used, the map belongs to other files, or the match is probably wrong.
        OutputError: the output is one of the files that are read.
    """
    file = split_asset(Path(transfer.source))[0]
    if is_same_file(file, transfer.target):
        raise zo.MeshError(f"{transfer.source} is both source and target: give two files.")
    surfaces = read_file(context, transfer.source, "source")
    with keep_as_blend(transfer.source) as library:
        own = read_file(context, transfer.target, "target")
        if transfer.output:
            read = [file, transfer.target, *bpy.utils.blend_paths(absolute=True)]
            check_output(transfer.output, read, transfer.in_place)
        brought = Brought(context, library, list(surfaces))
    matches = _match_files(context, brought.names, surfaces, own, transfer)

    def work(name: str) -> Work[Write[dict[str, Any]]]:
        return _prepare(context, matches[name][0], name, transfer)

    outcome = run(each_target(list(own), work))
    if review is not None:
        review(brought.names, matches, outcome)
    for name in own:  # their matches refer to objects of another file
        stored_match.remove(bpy.data.objects[name].data)
        stored_candidates.remove(bpy.data.objects[name].data)
    brought.remove(context, list(own))
    return outcome


def _match_files(
    context: Context,
    source_names: Sequence[str],
    source_surfaces: Mapping[str, zo.Surface],
    targets: Mapping[str, zo.Surface],
    transfer: FileTransfer,
) -> dict[str, tuple[str, stored_match.StoredMatch]]:
    """Match the objects of two files, or load their map; returns the first source and the match of each target."""
    sources = Parts.of([fingerprint_source(context, name) for name in source_names], list(source_surfaces.values()))
    joined = Parts.of([fingerprint_target(context, name) for name in targets], list(targets.values()))
    known = KnownMatch.load(transfer.map_file, sources.joined, joined.joined) if transfer.map_file else None
    matches = run(prepare_parts(context, sources, joined, known, transfer.detail))()
    check_verdicts(matches, transfer.force)
    return matches


async def _prepare(context: Context, source: str, target: str, transfer: FileTransfer) -> Write[dict[str, Any]]:
    """Prepare a transfer that binds the target if possible; otherwise a note gives the reason."""
    data, settings = transfer.data, transfer.settings
    unbound: str = ""
    if transfer.binding is not None:
        try:
            return await prepare_transfer(context, source, target, data, settings, transfer.binding)
        except zo.MeshError as error:
            unbound = warning("'{target}' was not bound to a rig: {reason}", target=target, reason=error)
    write = await prepare_transfer(context, source, target, data, settings)
    if not unbound:
        return write

    def write_and_say() -> dict[str, Any]:
        report = write()
        return report | {"notes": [*report["notes"], unbound]}

    return write_and_say
