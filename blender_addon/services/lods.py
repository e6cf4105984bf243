# SPDX-License-Identifier: GPL-3.0-or-later
"""Make levels of detail of an object: further objects with fewer vertices and all of its data."""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import bpy
from bpy.types import Collection, Context, Object

from zoomout_core.assets.given_levels import complete_levels
from zoomout_core.assets.level import Level
from zoomout_core.assets.lods import make_lods
from zoomout_core.messages import enumeration, message, sentences
from zoomout_core.runtime.progress import stage

from .. import mesh_data
from ..jobs import compute, pause, run
from ..scene.pair import edit_error, find_mesh, name_of
from .targets import Write

# Key of a custom property of levels and of their collection, with the name of the object that they were made of.
LEVEL_OF = "zoomout_level_of"
# Suffix of the names of levels: Unity groups them by it.
SUFFIX = re.compile(r"_LOD\d+$")


@dataclass(frozen=True)
class LevelChoice:
    """Which levels are made.

    Attributes:
        ratios: for each level after the object itself the share of its vertices, between 0 and 1.
        max_weights: maximum number of bones that move a vertex of these levels; 0 for that of the object.
        meshes: names of objects whose meshes become the levels, instead of simplified ones, in any order; they are
            in the place and rest pose of the object.
        keep_uv: whether these meshes keep their own UV maps.
    """

    ratios: tuple[float, ...] = (0.5, 0.25, 0.125)
    max_weights: int = 4
    meshes: tuple[str, ...] = ()
    keep_uv: bool = False


def make_levels(context: Context, obj: Object, choice: LevelChoice | None = None) -> dict[str, Any]:
    """Make levels of detail of an object, with its weights, shape keys, UV maps, attributes, materials and normals.

    They are copies of the object with new meshes, named `NAME_LOD1` and so on, in a collection. `NAME_LOD0` shares the
    object's mesh. They are hidden in the view, as all are in the same place. Earlier levels are replaced. Objects with
    given meshes stay; if one has the name of a level, " given" is added to it.

    Args:
        context: Blender's; the object is in its scene.
        obj: the object, whose mesh before its modifiers is simplified.
        choice: which levels to make.

    Returns:
        A report: `source` and `collection` are names; `levels` has for each new mesh its `name`, `vertices`,
        `rest_error` and `posed_error` (see `zoomout_core.assets.lods.Level`); `notes` are sentences.

    Raises:
        MeshError: the object has no surface, a level would have too few vertices, or a given mesh is elsewhere; nothing
            was written.
    """
    return run(prepare_levels(context, name_of(obj), choice or LevelChoice()))()


async def prepare_levels(context: Context, name: str, choice: LevelChoice) -> Write[dict[str, Any]]:
    """`make_levels` without writing: returns a function that writes."""
    with stage("Reading the mesh", 0, 0):
        obj = find_mesh(context, name)
        detailed = mesh_data.read_detailed_mesh(obj)
        given = {each: mesh_data.read_given_level(find_mesh(context, each), obj) for each in choice.meshes}
        contents = {each: mesh_data.content_hash(find_mesh(context, each).data) for each in (name, *given)}
        await pause()
    limit = choice.max_weights or None
    if given:
        completed = await compute(partial(complete_levels, detailed.asset, given, limit, choice.keep_uv))
        levels = list(completed.values())
    else:
        levels = await compute(partial(make_lods, detailed.asset, choice.ratios, limit))

    def write() -> dict[str, Any]:
        obj = find_mesh(context, name)
        for each, content in contents.items():
            if mesh_data.content_hash(find_mesh(context, each).data) != content:
                raise edit_error(each)
        base = SUFFIX.sub("", name)
        with mesh_data.all_or_nothing() as writing:
            earlier = [each for each in bpy.data.objects if each.get(LEVEL_OF) == name and each.library is None]
            writing.replace(*earlier, *{each.data for each in earlier if each.data != obj.data})
            collection = _collection(context, name, base)
            if not name.endswith("_LOD0"):
                first = obj.copy()
                first.name = f"{base}_LOD0"
                _place(context, first, name, collection)
            made = [
                mesh_data.add_level(obj, f"{base}_LOD{number}", detailed, level)
                for number, level in enumerate(levels, start=1)
            ]
            for number, each in enumerate(made, start=1):
                _place(context, each, name, collection)
                _free_name(each, f"{base}_LOD{number}", given)
        return {
            "source": name,
            "collection": collection.name,
            "levels": [_describe(each, level) for each, level in zip(made, levels, strict=True)],
            "notes": _notes(detailed, levels),
        }

    return write


def summary(report: Mapping[str, Any]) -> str:
    """The report in a sentence."""
    levels = [
        message("{vertices:,} vertices ({error:.2%})", vertices=level["vertices"], error=_largest_error(level))
        for level in report["levels"]
    ]
    done = message(
        "Made levels of '{source}', hidden in the collection '{collection}': {levels}. In brackets is the mean "
        "distance in poses, relative to the size",
        source=report["source"],
        collection=report["collection"],
        levels=enumeration(levels, ", "),
    )
    return sentences(message("{done}.", done=done), *report["notes"]) if report["notes"] else done


def _collection(context: Context, name: str, base: str) -> Collection:
    """The collection of the levels of an object, new if there is none."""
    for each in context.scene.collection.children_recursive:
        if each.get(LEVEL_OF) == name and each.library is None:
            return each
    made = bpy.data.collections.new(f"{base} LODs")
    made[LEVEL_OF] = name
    context.scene.collection.children.link(made)
    return made


def _place(context: Context, level: Object, name: str, collection: Collection) -> None:
    """Put a level into its collection, hidden in the view."""
    level[LEVEL_OF] = name
    collection.objects.link(level)
    level.select_set(False)
    if level.name in context.view_layer.objects:
        level.hide_set(True)


def _free_name(level: Object, name: str, given: Container[str]) -> None:
    """Give a level its name if one of the given objects has it, which is renamed."""
    holder = bpy.data.objects.get((name, None))
    if level.name != name and holder is not None and holder.name in given:
        holder.name = f"{name} given"
        level.name = name


def _describe(made: Object, level: Level) -> dict[str, Any]:
    return {
        "name": made.name,
        "vertices": len(made.data.vertices),
        "rest_error": level.rest_error,
        "posed_error": level.posed_error,
    }


def _largest_error(level: Mapping[str, Any]) -> float:
    """The error in poses, or at rest for a mesh without bones."""
    return float(level["rest_error"] if level["posed_error"] is None else level["posed_error"])


def _notes(detailed: mesh_data.DetailedMesh, levels: list[Level]) -> list[str]:
    notes: list[str] = [
        message("Level {number}: {note}", number=number, note=note)
        for number, level in enumerate(levels, start=1)
        for note in level.notes
    ]
    if detailed.left_out:
        notes.append(message("The levels do not have {names}.", names=enumeration(detailed.left_out, ", ")))
    return notes
