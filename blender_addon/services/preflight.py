# SPDX-License-Identifier: GPL-3.0-or-later
"""Obstacles to a match or a transfer, and reasons to doubt one, by fast checks.

All functions may be called each time the sidebar is drawn: they compare counts and flags; what takes longer is cached
by `mesh_facts`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.messages import as_message, enumeration, message

from .. import mesh_data
from ..scene.landmarks import landmarks_fingerprint
from ..scene.mesh_facts import facts
from ..scene.pair import check_distinct, check_writable, users_of_mesh
from ..scene.selection import choose_source, chosen_targets, match_source, own_sources
from ..storage import stored_match

# Meshes of fewer vertices have too few features to be matched by.
FEW_VERTICES = 100


class Finding(NamedTuple):
    """A sentence for the user.

    Attributes:
        text: what is wrong, and what to do.
        blocks: whether nothing can be done before.
        begins: whether it says how to begin, where nothing is wrong.
    """

    text: str
    blocks: bool
    begins: bool = False


HOW_TO_BEGIN = Finding("Select the source mesh, then Shift-click the target mesh.", True, begins=True)
NO_TARGET = "Make the target mesh active"


def obstacle(context: Context) -> str:
    """Why the active object cannot receive data, or nothing."""
    target = context.active_object
    if target is None or target.type != "MESH":
        return NO_TARGET
    if target.data.is_editmode and target.mode != "EDIT":
        return "The active mesh is in Edit Mode through another object: leave Edit Mode there"
    if target.library is not None or target.data.library is not None:
        return "The active mesh is linked from another file: Object > Relations > Make Local"
    return ""


def likely_source(context: Context) -> Object | None:
    """The source that an operator would choose for the active object, or None where it would refuse."""
    try:
        return choose_source(context, context.active_object, edited=True)
    except zo.MeshError:
        return None


def findings(context: Context) -> list[Finding]:
    """What the user should know before matching or transferring; what blocks comes first, and alone."""
    target, several = context.active_object, len(own_sources(context)) > 1
    if not _is_any_chosen(context) and not match_source(context, target):
        return [HOW_TO_BEGIN]
    if reason := obstacle(context):
        return [Finding(message("{reason}.", reason=as_message(reason)), True, begins=reason == NO_TARGET)]
    if several:
        return []
    try:
        source = choose_source(context, target, edited=True)
        check_distinct(source, target)
        check_writable(target)
    except zo.MeshError as error:
        return [Finding(str(error), True)]
    blocking = [Finding(text, True) for text in _blocking(context, source, target)]
    doubtful = [
        *_find_left_out(context, source, target),
        *_parts_of_characters(context, source),
        *_doubtful(context, source, target),
    ]
    return blocking or [Finding(text, False) for text in doubtful]


def _is_any_chosen(context: Context) -> bool:
    """Whether a source is chosen, or a mesh is selected beside the active object."""
    if context.scene.zoomout.source is not None:
        return True
    active = context.active_object
    return active is not None and any(obj.type == "MESH" and obj != active for obj in context.selected_objects)


def evaluated_data(context: Context, obj: Object) -> Mesh | None:
    """An object's mesh as its modifiers leave it, or None where it is disabled; it is up to date before drawing.

    In Edit Mode it is the object's own, as it was before: the other one has nothing to be counted.
    """
    if obj.mode == "EDIT":
        return obj.data
    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
    return evaluated.data if evaluated.is_evaluated else None


def stale(context: Context, target: Object) -> str:
    """Why the match stored on a target is no longer valid, as far as fast checks show; or "".

    Operators compare fingerprints, which is exact but slower.
    """
    stored = stored_match.description(target.data)
    if stored is None:
        return ""
    recorded = {
        role: {what: stored[what][role] for what in ("size", "mirrored", "content")} for role in ("source", "target")
    }
    for then in ({"name": stored["source"], **recorded["source"]}, *stored_match.others(stored)):
        source = context.scene.objects.get(then["name"])
        if source is None or source.type != "MESH":
            return message(
                "Its source '{source}' is not in the scene: choose the source, then match again.", source=then["name"]
            )
        if _is_edited(source, evaluated_data(context, source), then):
            return message("The source '{source}' was edited after the match: match again.", source=source.name)
    if _is_edited(target, target.data, recorded["target"]):
        return message("The target '{target}' was edited after the match: match again.", target=target.name)
    return ""


def _is_edited(obj: Object, mesh: Mesh | None, then: Mapping[str, Any]) -> bool:
    """Whether an object, whose mesh is now this one, was other when it was matched; its own may have been that."""
    known = facts(obj)
    sizes = [] if mesh is None else [[len(one.vertices), len(one.polygons)] for one in (mesh, obj.data)]
    return (
        (mesh is not None and then["size"] not in sizes)
        or obj.matrix_world.is_negative != then["mirrored"]
        or (known is not None and known.content != then["content"])
    )


def find_outdated(context: Context, target: Object) -> list[str]:
    """Sentences about what is other than when a target was matched, though its match still holds."""
    stored = stored_match.description(target.data)
    source = likely_source(context) if stored else None
    if stored is None or source is None:
        return []
    if source.name != stored["source"]:
        return [message("The source is now '{source}': match again to use it.", source=source.name)]
    then = stored.get("settings", {}).get(stored_match.LANDMARKS)
    if then is not None and then != landmarks_fingerprint(context.scene, source, target):
        return ["Landmarks have changed since the match: match again to use them."]
    return []


def _blocking(context: Context, source: Object, target: Object) -> Iterator[str]:
    for obj in (source, target):
        seen = evaluated_data(context, obj)
        if seen is None:
            yield message("'{name}' or its collection is disabled in the viewport: enable it.", name=obj.name)
        elif obj == target and not len(obj.data.polygons):
            yield mesh_data.without_faces(obj)
        elif not len(seen.polygons):
            yield message("'{name}' has no faces: choose a mesh with a surface.", name=obj.name)


def _find_left_out(context: Context, source: Object, target: Object) -> Iterator[str]:
    """Why other targets than the active one cannot receive data, where nothing is wrong with the source."""
    for other in chosen_targets(context, source):
        if other != target and (reason := _reason(context, source, other)):
            yield message("{reason} Until then, '{target}' is skipped.", reason=reason, target=other.name)


def _parts_of_characters(context: Context, source: Object) -> Iterator[str]:
    """Targets that are parts of one character, but are matched individually."""
    if context.scene.zoomout.initial != "AUTO":
        return
    characters = Counter(obj.find_armature() or obj.parent for obj in chosen_targets(context, source))
    for character, number in characters.items():
        if character is not None and number > 1:
            yield message(
                "{count} targets are parts of '{character}': match them together for a better result, see Collections.",
                count=number,
                character=character.name,
            )


def _reason(context: Context, source: Object, target: Object) -> str:
    try:
        check_distinct(source, target)
        check_writable(target)
    except zo.MeshError as error:
        return str(error)
    return next(_blocking(context, source, target), "")


def _doubtful(context: Context, source: Object, target: Object) -> Iterator[str]:
    both = source, target
    for obj in both:
        count, known = len(obj.data.vertices), facts(obj)
        if count < FEW_VERTICES and context.scene.zoomout.initial == "AUTO":
            yield message(
                "'{name}' has only {count} vertices, too few for automatic matching: subdivide it, or "
                "use Nearest Points.",
                name=obj.name,
                count=count,
            )
        if known is not None and known.non_manifold_edges:
            yield message(
                "'{name}' has edges with more than two faces ({count}): if the match is wrong there, "
                "find them with Select > All by Trait > Non Manifold and repair them.",
                name=obj.name,
                count=known.non_manifold_edges,
            )
    parts = {obj.name: known.parts for obj in both if (known := facts(obj))}
    if max(parts.values(), default=1) > 1:
        counts = enumeration(message("{count} in '{name}'", count=number, name=name) for name, number in parts.items())
        yield message(
            "Loose parts ({counts}) are paired by position and size: check eyes, teeth and clothes after the match.",
            counts=counts,
        )
    mirrored = [obj.name for obj in both if mesh_data.is_mirrored(obj)]
    if len(mirrored) == 1:
        yield message(
            "'{name}' has a negative scale, which swaps its sides: apply the scale unless this is intended.",
            name=mirrored[0],
        )
    if target.data.users > 1 and (users := users_of_mesh(context, target)) > 1:
        yield message(
            "{users} objects share the mesh of '{target}' and all receive the data: make it "
            "single-user to prevent this.",
            users=users,
            target=target.name,
        )


def is_reshaped(obj: Object, stored: dict[str, Any]) -> bool:
    """Whether, as far as is known, vertices of an object's mesh were moved since."""
    known = facts(obj)
    return known is not None and known.content != stored.get("content", known.content)
