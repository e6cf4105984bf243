# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects of the scene are the source and the targets, by the sidebar and the selection."""

from __future__ import annotations

from bpy.types import Context, Object

import zoomout_core as zo

from ..storage import stored_match
from .pair import find_mesh


def choose_source(context: Context, target: Object, named: str = "", edited: bool = False) -> Object:
    """The source for a target.

    It is the object that is named, else the one chosen in the scene, else the one mesh that is selected
    besides the target, else the one that the target was matched with. It may be `edited`, see `find_mesh`.

    Raises:
        MeshError: it is not a mesh that can be read, or there is no telling which it is.
    """
    return find_mesh(context, source_name(context, target, named), edited)


def source_name(context: Context, target: Object, named: str = "") -> str:
    """The name of the source that `choose_source` gives, whatever it names.

    Raises:
        MeshError: there is no telling which it is.
    """
    chosen = context.scene.zoomout.source
    selected = [obj.name for obj in context.selected_objects if obj.type == "MESH" and obj != target]
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
    """The name of the source that a target was matched with; empty without one, or where it is not in the scene."""
    stored = stored_match.description(target.data) if target and target.type == "MESH" else None
    return stored["source"] if stored and stored["source"] in context.scene.objects else ""


def chosen_targets(context: Context, source: Object | None = None) -> list[Object]:
    """The active object and all other selected meshes but the source; of those that share a mesh, the first."""
    meshes = [obj for obj in (context.active_object, *context.selected_objects) if obj and obj.type == "MESH"]
    of_mesh = {obj.data: obj for obj in reversed(meshes) if obj != source}
    return list(dict.fromkeys(obj for obj in meshes if of_mesh.get(obj.data) == obj))


def target_names(context: Context, source: Object) -> list[str]:
    """Their names; that of the active object, which then is the source itself, where there are none."""
    return [obj.name for obj in chosen_targets(context, source) or [context.active_object]]


def own_sources(context: Context) -> dict[str, str]:
    """For the names of all targets the sources that they were matched with, where these are meant; else empty.

    They are where none is chosen, and all meshes that are selected were matched with others that are not: as the
    targets of a match of collections. Of two that have one source, the other may be the source for the active one.
    """
    if context.scene.zoomout.source is not None:
        return {}
    found = {obj.name: match_source(context, obj) for obj in chosen_targets(context)}
    sources = set(found.values())
    if not all(sources) or sources & found.keys() or (len(found) == 2 and len(sources) == 1):
        return {}
    return found


def sources_of_targets(context: Context, named: str = "") -> dict[str, str]:
    """For the names of all targets those of their sources: their own, or one for all.

    Raises:
        MeshError: there is no telling which it is.
    """
    if not named and (own := own_sources(context)):
        return own
    source = choose_source(context, context.active_object, named)
    return dict.fromkeys(target_names(context, source), source.name)


def participants(context: Context) -> tuple[Object, list[Object]]:
    """The source and the targets that the sidebar and the selection name, in whatever mode they are.

    Raises:
        MeshError: there is no telling which is the source, or it is none.
    """
    active = context.active_object
    name = source_name(context, active)
    source = context.scene.objects.get(name)
    if source is None or source.type != "MESH":
        raise zo.MeshError("There is no mesh '{name}' in the scene: choose another source.", name=name)
    return source, chosen_targets(context, source)


def source_of_worn(context: Context, target: Object, named: str = "") -> str:
    """The name of the source that wears what a target is dressed with; others are selected besides.

    It is the object that is named, else the one chosen in the scene, else the one that the target was matched with.

    Raises:
        MeshError: there is no telling which it is.
    """
    chosen = context.scene.zoomout.source
    name = named or (chosen.name if chosen else "") or match_source(context, target)
    if not name:
        raise zo.MeshError("The source is missing: in the sidebar, choose the body that wears the objects.")
    return name


def worn_names(context: Context, source: str, target: str, collection: str = "") -> list[str]:
    """The names of the objects that a target is to be dressed with.

    They are those of a collection that is named, else of the one chosen in the scene, else all that are selected.

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
    return [obj.name for obj in objects if obj.name not in (source, target)]
