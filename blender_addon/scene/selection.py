# SPDX-License-Identifier: GPL-3.0-or-later
"""The source and the targets, chosen by the sidebar and the selection."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
from bpy.types import Context, Object

import zoomout_core as zo

from ..mesh_data import is_worn_copy, original_name
from ..storage import stored_match
from .pair import find_mesh


def choose_source(context: Context, target: Object, named: str = "", edited: bool = False) -> Object:
    """The source for a target.

    It is the first of these that exists: the object `named`, the one chosen in the scene, the only mesh selected
    besides the target and its clothes, the one that the target was matched with. For `edited`, see `find_mesh`.

    Raises:
        MeshError: it is not a mesh that can be read, or the source is ambiguous or missing.
    """
    return find_mesh(context, source_name(context, target, named), edited)


def source_name(context: Context, target: Object, named: str = "") -> str:
    """The name of the source for `choose_source`, whether or not it is a mesh.

    Raises:
        MeshError: the source is ambiguous or missing.
    """
    chosen = context.scene.zoomout.source
    selected = [obj.name for obj in selected_meshes(context) if obj != target]
    name = named or (chosen.name if chosen else "")
    if not name and len(selected) > 1:
        raise zo.MeshError(
            "{count} meshes are selected besides the active one: select only the source, or choose it in the sidebar.",
            count=len(selected),
        )
    name = name or "".join(selected) or match_source(context, target)
    if not name:
        raise zo.MeshError("There is no source: choose it in the sidebar, or select it first and the target last.")
    return name


def match_source(context: Context, target: Object | None) -> str:
    """The name of the source that a target was matched with; empty if there is none in the scene."""
    stored = stored_match.description(target.data) if target and target.type == "MESH" else None
    return stored["source"] if stored and stored["source"] in context.scene.objects else ""


def selected_meshes(context: Context) -> list[Object]:
    """The active mesh and all other selected ones, except copies that objects wear, because *Dress* selects them."""
    active = context.active_object
    others = [obj for obj in context.selected_objects if obj != active and not is_worn_copy(obj)]
    return [obj for obj in (active, *others) if obj and obj.type == "MESH"]


def chosen_targets(context: Context, source: Object | None = None) -> list[Object]:
    """The active and all other selected meshes except the source; of those that share a mesh, the first."""
    meshes = selected_meshes(context)
    of_mesh = {obj.data: obj for obj in reversed(meshes) if obj != source}
    return list(dict.fromkeys(obj for obj in meshes if of_mesh.get(obj.data) == obj))


def target_names(context: Context, source: Object) -> list[str]:
    """The names of the targets; without targets that of the active object, which then is the source itself."""
    return [obj.name for obj in chosen_targets(context, source) or [context.active_object]]


def own_sources(context: Context) -> dict[str, str]:
    """The source that each target was matched with, by the targets' names; empty if one source applies to all.

    Targets use their own sources if no source is chosen, and all selected meshes were matched with others that are not
    selected, such as the targets of matched collections. Two meshes with the same source are an exception: the other
    one may be meant as the source for the active one.
    """
    if context.scene.zoomout.source is not None:
        return {}
    found = {obj.name: match_source(context, obj) for obj in chosen_targets(context)}
    sources = set(found.values())
    if not all(sources) or sources & found.keys() or (len(found) == 2 and len(sources) == 1):
        return {}
    return found


def sources_of_targets(context: Context, named: str = "") -> dict[str, str]:
    """The name of each target's source, by the targets' names: their own ones, or one for all.

    Raises:
        MeshError: the source is ambiguous or missing.
    """
    if not named and (own := own_sources(context)):
        return own
    source = choose_source(context, context.active_object, named)
    return dict.fromkeys(target_names(context, source), source.name)


def participants(context: Context) -> tuple[Object, list[Object]]:
    """The source and the targets by the sidebar and the selection, in any mode.

    Raises:
        MeshError: the source is ambiguous or missing, or not a mesh.
    """
    active = context.active_object
    name = source_name(context, active)
    source = context.scene.objects.get(name)
    if source is None or source.type != "MESH":
        raise zo.MeshError("There is no mesh '{name}' in the scene: choose another source.", name=name)
    return source, chosen_targets(context, source)


def source_of_worn(context: Context, target: Object, named: str = "") -> str:
    """The name of the source whose clothes dress a target. The selection is ignored, because it may be the clothes.

    It is the first of these that exists: the object `named`, the one chosen in the scene, the one that the target was
    matched with.

    Raises:
        MeshError: the source is missing.
    """
    chosen = context.scene.zoomout.source
    name = named or (chosen.name if chosen else "") or match_source(context, target)
    if not name:
        raise zo.MeshError("The source is missing: in the sidebar, choose the body that wears the objects.")
    return name


def worn_names(context: Context, source: str, target: str, collection: str = "") -> list[str]:
    """The names of the objects to dress a target with.

    They are the objects in the named collection, else in the one chosen in the scene, else all selected objects; of
    copies that the target wears already, those that were copied.

    Raises:
        MeshError: there is no such collection.
    """
    chosen = context.scene.zoomout.dress_collection
    if collection:
        chosen = next((each for each in context.scene.collection.children_recursive if each.name == collection), None)
        if chosen is None:
            raise zo.MeshError(
                "There is no collection '{collection}' in the scene: choose another one.", collection=collection
            )
    objects = context.selected_objects if chosen is None else chosen.all_objects
    names = (original_name(obj, target) for obj in objects)
    return [name for name in dict.fromkeys(names) if name not in (source, target)]


def select_only(context: Context, names: Sequence[str]) -> None:
    """Select the objects of some names, and no others; the first becomes active unless one of them is."""
    for obj in context.selected_objects:
        obj.select_set(False)
    chosen = [context.view_layer.objects[name] for name in names if name in context.view_layer.objects]
    for obj in chosen:
        obj.select_set(True)
    if chosen and context.active_object not in chosen:
        context.view_layer.objects.active = chosen[0]


def library_folders(context: Context) -> list[str]:
    """The folders to search, by the scene's settings and the asset libraries of the Preferences."""
    settings = context.scene.zoomout
    chosen = [settings.library_folder] if settings.library_folder else []
    if settings.use_asset_libraries:
        chosen += asset_libraries(context)
    return [bpy.path.abspath(folder) for folder in chosen]


def asset_libraries(context: Context) -> list[str]:
    """The folders of the asset libraries of the Preferences; that of the default one may not exist yet."""
    return [each.path for each in context.preferences.filepaths.asset_libraries if Path(each.path).is_dir()]
