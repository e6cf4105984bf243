# SPDX-License-Identifier: GPL-3.0-or-later
"""Add the fitted copies to the scene, and bind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from bpy.types import Context, Object

from zoomout_core.messages import Message, plural, plural_warning

from ... import mesh_data
from ...adapters.key_drivers import notes_on_drivers
from ...mesh_data import ObjectPair, OutfitBones
from ...scene.pair import find_mesh
from .fit import Fit
from .read import Fitting, Rigs


def write_copies(
    context: Context,
    pair: ObjectPair,
    fitting: Fitting,
    fit: Fit,
    writing: mesh_data.Writing,
) -> tuple[dict[str, str], list[str]]:
    """Add the copies; returns their names by those of the originals, and notes."""
    target = find_mesh(context, pair.target_name)
    bodies = [find_mesh(context, name) for name in pair.source_names]
    collection = mesh_data.collection_beside(context, target, mesh_data.dress_name(target.name))
    made, notes = {}, []
    for number, worn in enumerate(fitting.worn):
        positions, turns = fit.dressed.vertices[number], fit.dressed.turns[number]
        obj = context.scene.objects[worn.name]
        for earlier in mesh_data.worn_copies_in(collection, worn.name):
            writing.replace(earlier, earlier.data)
        copy, more = mesh_data.add_worn_copy(worn, obj, positions, turns, target, bodies, collection, fit.moved)
        if copy.type == "CURVES":
            mesh_data.attach_strands(copy, target, fitting.target, positions)
        elif fitting.keys is not None:
            keys = fitting.keys.keys
            mesh_data.write_body_keys(copy, target, keys, fit.keys[number], worn.place(fit.moved))
        if fitting.rigs is not None:
            source_rig, target_rig = (
                context.scene.objects[name] for name in (fitting.rigs.source, fitting.rigs.target)
            )
            mesh_data.bind_to_other(copy, source_rig, target_rig, fit.pairs, worn.place(fit.moved))
            change = fit.weights[number]
            if change is not None:
                mesh_data.update_weights(copy, *change)
        made[worn.name] = copy.name
        notes.extend(more)
    context.view_layer.update()
    if fitting.rigs is not None and fit.outfit is not None:
        mesh_data.add_outfit_bones(context, *_armatures(context, fitting.rigs), fit.outfit, fit.pairs)
        notes.extend(_notes_on_bones(fit.outfit, fit.pairs, fitting.rigs.target))
    for name, copy in made.items():
        notes.extend(_redirect_drivers(context, name, copy, target, bodies, fitting, fit))
    return made, notes


def _redirect_drivers(
    context: Context, original: str, made: str, target: Object, bodies: Sequence[Object], fitting: Fitting, fit: Fit
) -> list[Message]:
    """Let drivers of a copy's own keys read the target, its keys and its armature; returns notes."""
    obj, copy = (context.scene.objects[name] for name in (original, made))
    if copy.type != "MESH" or copy.data.shape_keys is None:
        return []
    keys, blocks = target.data.shape_keys, dict[Any, Any]()
    if keys is not None:
        blocks |= dict.fromkeys((keys, *(each.data.shape_keys for each in bodies if each.data.shape_keys)), keys)
    if obj.data.shape_keys is not None:
        blocks[obj.data.shape_keys] = copy.data.shape_keys
    blocks |= {part: part for body in bodies for each in mesh_data.armatures_of(body) for part in (each, each.data)}
    bones = None
    if fitting.rigs is not None and fit.outfit is not None:
        armatures = _armatures(context, fitting.rigs)
        blocks |= mesh_data.partner_armatures(*armatures)
        before, now = (each.data.bones for each in armatures)  # with bones that control others, and move no vertices
        bones = {name: name for name in {*before.keys()} & {*now.keys()}} | fit.pairs
    read = mesh_data.Partners(blocks, bones, dict.fromkeys(bodies, target) | {obj: copy})
    return notes_on_drivers(mesh_data.redirect_drivers(copy.data.shape_keys, read), copy)


def _armatures(context: Context, rigs: Rigs) -> tuple[Object, Object]:
    """The source's and the target's armature."""
    return context.scene.objects[rigs.source], context.scene.objects[rigs.target]


def _notes_on_bones(outfit: OutfitBones, pairs: dict[str, str], armature: str) -> Iterator[Message]:
    """Sentences on the armature that the copies were bound to."""
    yield plural(
        len(outfit.names),
        "The objects are bound to '{armature}', to which 1 bone of their own was added.",
        "The objects are bound to '{armature}', to which {count} bones of their own were added.",
        armature=armature,
    )
    missing = [name for name in outfit.of_body if name not in pairs]
    if missing:
        yield plural_warning(
            len(missing),
            "A bone that moves the objects, '{bone}', has no partner in '{armature}': assign its weights to another "
            "bone.",
            "{count} bones that move the objects have no partner in '{armature}', such as '{bone}': assign their "
            "weights to other bones.",
            armature=armature,
            bone=missing[0],
        )
