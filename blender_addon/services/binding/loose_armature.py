# SPDX-License-Identifier: GPL-3.0-or-later
"""Move a copy of an armature that moves no vertex of the source, such as a metarig of Rigify, into a target."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.messages import Message, message
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer import map_target

from ... import mesh_data
from ...adapters import FILL_BELOW
from ...jobs import compute, run
from ...scene.pair import check_context, find_mesh, name_of, writing
from ...scene.stored_pair import stored_pair
from ..matching.made_match import BY_SCRIPT, MatchUse, find_match, push_match, store_and_stop
from ..matching.pair_match import check_options
from ..targets import Write
from .bind import move_bones, note_on_constraints
from .check import check_armature, moves_vertices
from .write import note_on_bends

# Fraction of the progress for a new match.
MATCHING = 0.8


@dataclass(frozen=True)
class MovedArmature:
    """A copy of an armature in a target that is not bound to it.

    Attributes:
        armature: the name of the original.
        copy: the name of the copy.
        target: the name of the target.
        notes: sentences for the user.
    """

    armature: str
    copy: str
    target: str
    notes: tuple[str, ...]

    @property
    def sentence(self) -> Message:
        """The result, for the user."""
        return message(
            "'{copy}' was placed in '{target}', which is not bound to it, because '{armature}' has no bone weights",
            copy=self.copy,
            target=self.target,
            armature=self.armature,
        )


def move_armature(
    context: Context, armature: Object, source: Object, target: Object, *, force: bool = False, **match_options: Any
) -> MovedArmature:
    """Place a copy of an armature that is inside a source, such as a metarig of Rigify, in a target.

    Bones follow the surface around them, in the visible pose of both. No weights are needed, and the target is not
    bound. The copy keeps the direction and scale of the original as an object.

    Args:
        context: Blender's; all objects are in its scene.
        armature: the armature, in its rest position inside the source.
        source: a mesh that the armature need not deform.
        target: the mesh that receives the copy; only its match is stored.
        force: whether to use a new match even if it is probably wrong.
        match_options: options of `match_objects`, for a new match.

    Raises:
        MeshError: the armature cannot be moved, or the objects cannot be matched; nothing was written.
        TypeError: an option of the match is unknown.
    """
    check_context(context)
    use, names = MatchUse(force=force), (name_of(armature), name_of(source), name_of(target))
    return run(prepare_armature(context, *names, use, **match_options))()


async def prepare_armature(
    context: Context, armature: str, source: str, target: str, use: MatchUse = BY_SCRIPT, **match_options: Any
) -> Write[MovedArmature]:
    """`move_armature` by the names of the objects, without writing, see `prepare_transfer`."""
    check_options(match_options)
    check_armature(_find_armature(context, armature))
    pair = await stored_pair(context, source, target)
    found = await find_match(context, pair, MATCHING, use, match_options)
    if found.refused is not None:
        return partial(store_and_stop, context, pair, found.refused, found.settings, use)
    original = _find_armature(context, armature)
    bones, notes = mesh_data.read_rig_bones(original), note_on_constraints(original)
    with portion(MATCHING, 1):
        bones = await compute(partial(_move, found.match, pair, bones))

    def write() -> MovedArmature:
        with writing(context, pair) as (first, obj):
            found.store(obj.data, pair)
            if found.is_new and use.undo_step:
                push_match()
            shift = np.eye(4)
            shift[:3, 3] = obj.matrix_world.translation - first.matrix_world.translation
            rig = _find_armature(context, armature)
            made = mesh_data.copy_loose_rig(context, rig, obj, bones, shift)
            bends = note_on_bends(mesh_data.bends_at_rest(rig, made))
            return MovedArmature(armature, made.name, target, (*notes, *bends))

    return write


def _find_armature(context: Context, name: str) -> Object:
    """An armature by its name.

    Raises:
        MeshError: the scene has none of this name.
    """
    found = context.scene.objects.get(name)
    if found is None or found.type != "ARMATURE":
        raise zo.MeshError("The scene has no armature '{name}': choose another one.", name=name)
    return found


def _move(match: Any, pair: mesh_data.ObjectPair, bones: mesh_data.RigBones) -> mesh_data.RigBones:
    mapped = map_target(match, pair.source, pair.target, FILL_BELOW)
    return move_bones(bones, mapped, pair.source, pair.target)


def loose_armature(context: Context, sources: Iterable[str]) -> str:
    """The name of the armature to move without weights; empty if bones move a source, or it is ambiguous.

    It is the one that a source is bound to without weights, otherwise the only selected one.
    """
    names = set(sources)
    if len(names) != 1:
        return ""
    source = find_mesh(context, names.pop())
    if moves_vertices(source):
        return ""
    selected = [obj for obj in context.selected_objects if obj.type == "ARMATURE"]
    found = mesh_data.armatures_of(source) or selected
    return found[0].name if len(found) == 1 else ""
