# SPDX-License-Identifier: GPL-3.0-or-later
"""Find a source for a mesh among the files of libraries, and append the one that the artist chooses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import bpy
from bpy.types import Context, Object
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.arrays import Bytes
from zoomout_core.library.pictures import draw_pair
from zoomout_core.mesh.formats.blender_files import BLEND
from zoomout_core.messages import message
from zoomout_core.runtime.input_files import check_path
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer import Attribute

from .. import mesh_data
from ..jobs import compute, run
from ..scene.files import COLLECTION, append_assets, append_file, assets_of, open_empty_scene, shown_meshes
from ..scene.pair import check_context, find_mesh, name_of
from .found_pictures import last_pictures
from .transfer_files import read_file

# Fraction of the progress that the preparation takes; a prepared library takes no time.
PREPARED = 0.5
# Share of the visible surface of a file above which the assets in it stand for it: a sword may be marked alone, but not
# its bearer.
MOSTLY = 0.5
# Pixels of the pictures of results, in width and height.
PICTURE = 128


class Search(NamedTuple):
    """The result of a search."""

    found: zo.FoundSources
    failures: dict[Path, str]  # why files were skipped, in a sentence each
    pictures: dict[Path, tuple[Bytes, Bytes]]  # of each file and of the target, in matching colours


def find_source(context: Context, target: Object, folders: Sequence[str]) -> Search:
    """Prepare libraries where necessary, and find the files in them that fit a target.

    Args:
        context: Blender's; the target is in its scene.
        target: a mesh object, which is read after its modifiers.
        folders: folders of files with finished characters.

    Raises:
        MeshError: the target has no surface, or a folder is missing or has no characters.
        TypeError: the folders are not a list.
    """
    if isinstance(folders, str | Path):
        raise TypeError(f"The folders are {str(folders)!r:.60}: give a list of them, such as ['characters'].")
    return run(find_source_async(context, name_of(target), folders))


async def find_source_async(context: Context, target: str, folders: Sequence[str]) -> Search:
    """Like `find_source`, by the name of the target, without blocking the window."""
    surface = mesh_data.read_source_surface(find_mesh(context, target), context.evaluated_depsgraph_get())
    # The module `bpy` has no program; a Python with it runs the extension as a module instead.
    search = await compute(partial(_search, surface, folders, bpy.app.binary_path or None))
    last_pictures.clear()
    last_pictures.update(search.pictures)
    return search


def _search(target: zo.Surface, folders: Sequence[str], program: str | None) -> Search:
    libraries = [zo.Library(folder, blender=program) for folder in folders]
    failures: dict[Path, str] = {}
    try:
        for number, library in enumerate(libraries):
            with portion(PREPARED * number / len(libraries), PREPARED * (number + 1) / len(libraries)):
                prepared = library.prepare()
            if prepared.failures and not prepared.assets:
                reason = next(iter(prepared.failures.values()))
                raise zo.MeshError("No file of {folder} can be used: {reason}", folder=library.folder, reason=reason)
            failures |= prepared.failures
        with portion(PREPARED, 1.0):
            found = zo.find_source(target, libraries)
        pictures = {
            each.path: draw_pair(each.match, PICTURE, PICTURE, blender=True) for each in found.ranked if each.match
        }
        return Search(found, failures, pictures)
    except OSError as error:
        raise zo.MeshError(str(error)) from error


def read_assets(context: Context, path: str) -> dict[str, zo.Surface | str]:
    """Open a file, and read the assets in it as surfaces, with modifiers, in world space.

    Collections and mesh objects of a .blend file that are marked as assets are one each; objects in such a collection
    are a part of it. If most of a file is not marked, all of its visible meshes are another asset, with an empty name.

    Returns:
        The surface of each asset, or why there is none, by names such as `Collection/Hero`.

    Raises:
        MeshError: the file cannot be opened, or has no visible mesh.
    """
    open_empty_scene()
    file = Path(path)
    names = assets_of(file) if file.suffix.lower() == BLEND else []
    appended = append_assets(context, file, names) if names else {}
    in_collections = {obj for name, own in appended.items() if name.startswith(COLLECTION) for obj in own}
    found: dict[str, zo.Surface | str] = {}
    for name, own in appended.items():
        if name.startswith(COLLECTION) or not in_collections.issuperset(own):
            shown = [find_mesh(context, each) for each in shown_meshes(own)]
            if shown:
                found[name] = _join(context, shown)
    marked = sum(surface.area for surface in found.values() if isinstance(surface, zo.Surface))
    try:
        whole = zo.Surface.joined(list(read_file(context, path, "source").values()))
    except zo.MeshError:
        if not found:
            raise
        return found  # of a file whose scene is empty
    return found if marked > MOSTLY * whole.area else {"": whole, **found}


def _join(context: Context, meshes: Sequence[Object]) -> zo.Surface | str:
    """Join meshes to one surface; returns the reason if that is impossible."""
    try:
        depsgraph = context.evaluated_depsgraph_get()
        return zo.Surface.joined([mesh_data.read_source_surface(mesh, depsgraph) for mesh in meshes])
    except zo.MeshError as error:
        return str(error)


def append_source(context: Context, path: str | Path, joints: Sequence[str] = ()) -> Object:
    """Append the objects of a file or an asset that was found, and choose the largest mesh as the source.

    Args:
        context: Blender's.
        path: the file or the asset.
        joints: limit transfers to these vertex groups of the active object, by a new group as their mask, so that the
            rest of its data can come from another source; without any, the mask stays as it is.

    Raises:
        MeshError: the file cannot be read, or has no mesh, or the active object has none of the groups.
    """
    check_context(context)
    check_path(path)
    selected, target = context.selected_objects, context.view_layer.objects.active
    mask = _sum_of_groups(target, joints) if joints else None
    with mesh_data.all_or_nothing():
        meshes = [obj for obj in append_file(context, path) if obj.type == "MESH" and obj.data.polygons]
        if not meshes:
            raise zo.MeshError(message("{name} has no mesh: choose another file.", name=Path(path).name))
    # Importers select the appended objects, which the next match would treat as targets.
    for obj in context.view_layer.objects:
        obj.select_set(obj in selected)
    source = max(meshes, key=mesh_data.area_in_world)
    context.scene.zoomout.source = source
    if mask is not None:
        mesh_data.write_weights(target, mask)
        context.scene.zoomout.mask_group = mask.labels[0]
    return source


def _sum_of_groups(obj: Object | None, names: Sequence[str]) -> Attribute:
    """The sum of some vertex groups as a new group, which is named after the first.

    Raises:
        MeshError: there is no object, or it has none of them.
    """
    weights = None if obj is None or obj.type != "MESH" else mesh_data.read_weights(obj, obj.data)
    columns = [] if weights is None else [number for number, name in enumerate(weights.labels) if name in names]
    if obj is None or weights is None or not columns:
        raise zo.MeshError(
            "The active object has no vertex group '{name}': transfer the vertex groups of the best source first.",
            name=names[0],
        )
    total = csr_array(weights.values[:, columns].sum(axis=1).clip(0, 1).reshape(-1, 1))
    return replace(weights, values=total, labels=(f"{names[0]} Mask",))
