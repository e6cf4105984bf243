"""Which objects of the scene are the source and the targets, by the sidebar and the selection."""

from __future__ import annotations

from bpy.types import Context, Object

import zoomout_core as zo

from ..storage import stored_match
from .pair import find_mesh


def choose_source(context: Context, target: Object, named: str = "", otherwise: str = "") -> Object:
    """The source for a target.

    It is the object that is named, else the one chosen in the scene, else the one mesh that is selected
    besides the target, else the one named `otherwise`.

    Raises:
        MeshError: it is not a mesh that can be read, or there is no telling which it is.
    """
    return find_mesh(context, source_name(context, target, named, otherwise))


def source_name(context: Context, target: Object, named: str = "", otherwise: str = "") -> str:
    """The name of the source that `choose_source` gives, whatever it names.

    Raises:
        MeshError: there is no telling which it is.
    """
    chosen = context.scene.zoomout.source
    selected = [obj.name for obj in context.selected_objects if obj.type == "MESH" and obj != target]
    name = named or (chosen.name if chosen else "")
    if not name and len(selected) > 1:
        raise zo.MeshError(
            f"{len(selected)} meshes are selected besides the active one: "
            "select the source alone, or choose it in the sidebar."
        )
    name = name or "".join(selected) or otherwise
    if not name:
        raise zo.MeshError("There is no source: choose it in the sidebar, or select it and then, last, the target.")
    return name


def chosen_targets(context: Context, source: Object | None = None) -> list[Object]:
    """The active object and all other selected meshes but the source; of those that share a mesh, the first."""
    meshes = [obj for obj in (context.active_object, *context.selected_objects) if obj and obj.type == "MESH"]
    of_mesh = {obj.data: obj for obj in reversed(meshes) if obj != source}
    return list(dict.fromkeys(obj for obj in meshes if of_mesh.get(obj.data) == obj))


def target_names(context: Context, source: Object) -> list[str]:
    """Their names; that of the active object, which then is the source itself, where there are none."""
    return [obj.name for obj in chosen_targets(context, source) or [context.active_object]]


def participants(context: Context) -> tuple[Object, list[Object]]:
    """The source and the targets that the sidebar and the selection name, in whatever mode they are.

    Raises:
        MeshError: there is no telling which is the source, or it is none.
    """
    active = context.active_object
    stored = stored_match.description(active.data) if active and active.type == "MESH" else None
    name = source_name(context, active, otherwise=stored["source"] if stored else "")
    source = context.scene.objects.get(name)
    if source is None or source.type != "MESH":
        raise zo.MeshError(f"There is no mesh '{name}' in the scene: choose another source.")
    return source, chosen_targets(context, source)
