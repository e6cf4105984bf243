# SPDX-License-Identifier: GPL-3.0-or-later
"""Fast checks for obstacles to a match or a transfer, and for reasons to doubt one.

The sidebar may call all functions at each redraw: they compare counts and flags, and `mesh_facts` caches slower facts.
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
from ..scene.mesh_facts import facts, latest_facts
from ..scene.pair import check_distinct, check_writable, users_of_mesh
from ..scene.selection import choose_source, chosen_targets, match_source, own_sources, selected_meshes
from ..storage import stored_match

# Meshes with fewer vertices have too few features for a match.
FEW_VERTICES = 100


class Finding(NamedTuple):
    """A sentence for the user.

    Attributes:
        text: the problem and its remedy.
        blocks: whether the problem has to be solved first.
        begins: whether it explains how to begin, without a problem.
    """

    text: str
    blocks: bool
    begins: bool = False


HOW_TO_BEGIN = Finding("Select the source mesh, then Shift-click the target mesh.", True, begins=True)
NO_TARGET = "Make the target mesh active"


def obstacle(context: Context) -> str:
    """The reason why the active object cannot receive data, or an empty string."""
    target = context.active_object
    if target is None or target.type != "MESH":
        return NO_TARGET
    if target.data.is_editmode and target.mode != "EDIT":
        return "The active mesh is in Edit Mode through another object: leave Edit Mode there"
    if target.library is not None or target.data.library is not None:
        return "The active mesh is linked from another file: Object > Relations > Make Local"
    return ""


def likely_source(context: Context) -> Object | None:
    """The source that an operator would choose for the active object, or None if it would fail."""
    try:
        return choose_source(context, context.active_object, edited=True)
    except zo.MeshError:
        return None


def findings(context: Context) -> list[Finding]:
    """Findings before matching or transferring; a blocking one is the only one."""
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
    """Whether a source is chosen, or a mesh besides the active object is selected."""
    if context.scene.zoomout.source is not None:
        return True
    active = context.active_object
    return active is not None and any(obj != active for obj in selected_meshes(context))


def evaluated_data(context: Context, obj: Object) -> Mesh | None:
    """An object's evaluated mesh, up to date even during drawing, or None if the object is disabled.

    In Edit Mode it is the object's own mesh as it was before, because the evaluated one has nothing to count.
    """
    if obj.mode == "EDIT":
        return obj.data
    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
    return evaluated.data if evaluated.is_evaluated and not mesh_data.is_disabled(obj) else None


def stale(context: Context, target: Object) -> str:
    """The reason why the match stored on a target is no longer valid, by fast checks; or an empty string.

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
    """Whether an object was edited since it was matched, by its present evaluated mesh and its own."""
    known = facts(obj)
    sizes = [] if mesh is None else [[len(one.vertices), len(one.polygons)] for one in (mesh, obj.data)]
    return (
        (mesh is not None and then["size"] not in sizes)
        or obj.matrix_world.is_negative != then["mirrored"]
        or (known is not None and known.content != then["content"])
    )


def find_outdated(context: Context, target: Object) -> list[str]:
    """Sentences about changes since a target was matched that do not invalidate its match."""
    stored = stored_match.description(target.data)
    source = likely_source(context) if stored else None
    if stored is None or source is None:
        return []
    if source.name != stored["source"]:
        return [message("The source is now '{source}': match again to use it.", source=source.name)]
    then = (stored.get("settings") or {}).get(stored_match.LANDMARKS)
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
    """Reasons why targets other than the active one cannot receive data."""
    for other in chosen_targets(context, source):
        if other != target and (reason := _reason(context, source, other)):
            yield message("{reason} Until then, '{target}' is skipped.", reason=reason, target=other.name)


def _parts_of_characters(context: Context, source: Object) -> Iterator[str]:
    """Sentences about targets that are parts of one character, but are matched individually."""
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
    """Sentences about properties of two objects that may make a match or transfer worse."""
    both = source, target
    for obj in both:
        yield from _doubts_about(context, obj)
    parts = {obj.name: known.parts for obj in both if (known := latest_facts(obj))}
    # After a match, its verdict says whether the parts have arrived.
    if len(parts) == len(both) and max(parts.values()) > 1 and match_source(context, target) != source.name:
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


def _doubts_about(context: Context, obj: Object) -> Iterator[str]:
    """Sentences about a mesh that may be too coarse to be matched, or that has faulty edges."""
    count, known = len(obj.data.vertices), latest_facts(obj)
    if count < FEW_VERTICES and context.scene.zoomout.initial == "AUTO":
        yield message(
            "'{name}' has only {count:,} vertices, too few for automatic matching: subdivide it, or "
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


def is_reshaped(obj: Object, stored: dict[str, Any]) -> bool:
    """Whether vertices of an object's mesh are known to have moved since a symmetry was stored."""
    known = facts(obj)
    return known is not None and known.content != stored.get("content", known.content)
