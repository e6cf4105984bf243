# SPDX-License-Identifier: GPL-3.0-or-later
"""Add bones of a second source to the armature of a target, for a part such as its face, with their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Context, Object
from scipy.sparse import csr_array, diags_array

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.messages import Message, message, plural
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer import Attribute, Domain, Kind, map_target
from zoomout_core.transfer.rigging.bone_pairs import Skeleton
from zoomout_core.transfer.rigging.shared_bones import SharedBones, share_bones
from zoomout_core.transfer.rigging.skinning import renumber_bones
from zoomout_core.transfer.rules import transfer_along

from ... import mesh_data
from ...jobs import compute, run
from ...mesh_data import Bones, ObjectPair, OutfitBones, RigBones
from ...scene.pair import find_mesh, name_of, writing
from ...scene.stored_pair import stored_pair
from ...storage.stored_match import Match
from ..matching.made_match import BY_SCRIPT, MatchUse, find_match, push_match, store_and_stop
from ..matching.pair_match import check_options
from .bind import move_bones
from .check import check_in_scene
from .read import Rigged, read_rigged, weights_of_bones

# Fraction of the progress for a new match.
MATCHING = 0.8


@dataclass(frozen=True, eq=False)
class AddedBones:
    """Bones that were added to the armature of a target.

    Attributes:
        names: their names, parents before children.
        parent: the bone that the first of them hangs from; empty if none was added.
        shared: how many bones of the target also have weights of the source.
    """

    names: tuple[str, ...]
    parent: str
    shared: int

    @property
    def sentence(self) -> Message:
        """The bones, for the user."""
        shared = plural(self.shared, "1 bone of both", "{count} bones of both")
        if not self.names:
            return message("The part received weights of {shared}; no bone was added", shared=shared)
        added = plural(len(self.names), "1 bone", "{count} bones")
        return message(
            "{added} added below '{parent}'; the part received their weights, and those of {shared}",
            added=added,
            parent=self.parent,
            shared=shared,
        )


def add_bones(
    context: Context, source: Object, target: Object, mask_group: str, *, force: bool = False, **match_options: Any
) -> AddedBones:
    """Add the bones of a source that move a part of a target to the target's own armature.

    Bones of the same name, or the same humanoid bone, are shared: those of the target stay where they are. Others are
    copied with their constraints to their places in the target, and hang from the target's bones. The part gets the
    weights of the source, the rest of the target keeps its own. Bones that an earlier call added are replaced.

    Args:
        context: Blender's; both objects are in its scene.
        source: an object that one armature deforms.
        target: an object that another armature deforms.
        mask_group: the vertex group of the target with its share of the source's weights. The group of a bone includes
            those of all bones below it.
        force: whether to use a new match even if it is probably wrong.
        match_options: options of `match_objects`, for a new match.

    Raises:
        MeshError: an object has no armature, or several, the target has no such group, or a bone of the source has the
            name of another bone of the target; nothing was written.
        TypeError: an option of the match is unknown.
    """
    use = MatchUse(force=force)
    return run(add_bones_async(context, name_of(source), name_of(target), mask_group, use, **match_options))


async def add_bones_async(
    context: Context,
    source: str,
    target: str,
    mask_group: str,
    use: MatchUse = BY_SCRIPT,
    **match_options: Any,
) -> AddedBones:
    """Like `add_bones`, by the names of the objects, without blocking the window; see `prepare_transfer`."""
    check_options(match_options)
    for name in (source, target):
        check_in_scene(context, find_mesh(context, name))
    armature, own_armature = (_armature_of(find_mesh(context, name)).name for name in (source, target))
    if armature == own_armature:
        raise zo.MeshError(
            "'{source}' and '{target}' have the same armature: choose a source with its own.",
            source=source,
            target=target,
        )
    mask = _read_mask(find_mesh(context, target), context.scene.objects[own_armature], mask_group)
    pair = await stored_pair(context, source, target)
    found = await find_match(context, pair, MATCHING, use, match_options)
    if found.refused is not None:
        store_and_stop(context, pair, found.refused, found.settings, use)
    rigged, part = read_rigged(context, pair), _read_part(context, pair, armature, own_armature, mask)
    with portion(MATCHING, 1):
        shared, bones = await compute(partial(_prepare, found.match, pair, rigged, part))
    pairs = {
        rigged.bones.names[number]: part.bones.names[other]
        for number, other in enumerate(shared.partners.tolist())
        if other >= 0
    }
    with writing(context, pair) as (_, obj):
        found.store(obj.data, pair)
        if found.is_new and use.undo_step:
            push_match()
        mesh_data.update_weights(obj, *_weights_with(part, shared, bones.names))
        obj.data.update()
        objects = context.scene.objects  # the armature is changed last, because only the mesh is rolled back
        mesh_data.add_outfit_bones(context, objects[armature], objects[own_armature], bones, pairs)
    return AddedBones(bones.names, bones.parents[0] if bones.names else "", len(pairs))


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a target.

    Attributes:
        rig: all bones of the source's armature.
        bones: the target's own deforming bones, without those that were added earlier.
        taken: names of all bones of its armature but these.
        groups: its vertex groups.
        rest: its surface at rest, in world space.
        mask: (n_t,) share of the source's weights.
    """

    rig: RigBones
    bones: Bones
    taken: frozenset[str]
    groups: Attribute
    rest: zo.Surface
    mask: Floats


def _armature_of(obj: Object) -> Object:
    """The armature of an object.

    Raises:
        MeshError: it has none, or several.
    """
    armatures = mesh_data.armatures_of(obj)
    if len(armatures) != 1:
        raise zo.MeshError(
            "'{name}' is bound to {count} armatures instead of one: bones for a part are added from one armature to "
            "another.",
            name=obj.name,
            count=len(armatures),
        )
    return armatures[0]


def _read_mask(target: Object, armature: Object, group: str) -> Floats:
    """(n_t,) the weights of a vertex group; those of a bone with the weights of all bones below it.

    Raises:
        MeshError: the target has no such group.
    """
    mask = mesh_data.read_mask(target, group)
    if group in armature.data.bones:
        weights = mesh_data.read_weights(target, target.data)
        below = {bone.name for bone in armature.data.bones[group].children_recursive}
        chosen = np.array([name in below for name in weights.labels], dtype=float)
        mask = np.clip(mask + weights.values @ chosen, 0, 1)
    return mask


def _read_part(context: Context, pair: ObjectPair, armature: str, own: str, mask: Floats) -> _Part:
    target, objects = find_mesh(context, pair.target_name), context.scene.objects
    bones = mesh_data.read_bones(target)
    added = mesh_data.bones_copied_from(objects[own], armature)
    kept = np.flatnonzero([name not in added for name in bones.names])
    number = {bone: new for new, bone in enumerate(kept.tolist())}
    parents = np.array([number.get(above, -1) for above in bones.parents[kept].tolist()], dtype=np.int64)
    rest = mesh_data.positions_in_world(target, mesh_data.read_rest_positions(target.data))
    return _Part(
        mesh_data.read_rig_bones(objects[armature]),
        Bones(tuple(bones.names[bone] for bone in kept), parents, bones.heads[kept]),
        frozenset(bone.name for bone in objects[own].data.bones) - added,
        mesh_data.read_weights(target, target.data),
        pair.target.with_vertices(rest),
        mask,
    )


def _prepare(match: Match, pair: ObjectPair, rigged: Rigged, part: _Part) -> tuple[SharedBones, OutfitBones]:
    """Find the bones to add, and their places in the target."""
    mapped = map_target(match, pair.source, pair.target)
    given = Attribute("weights", Domain.POINT, Kind.WEIGHT, rigged.weights, rigged.bones.names)
    weights = csr_array(transfer_along(given, mapped).values)
    bones, others = (Skeleton(each.names, each.parents, each.heads) for each in (rigged.bones, part.bones))
    own = weights_of_bones([part.groups], part.bones)
    shared = share_bones(bones, others, weights, own, part.mask, pair.target.vertex_areas)
    names = tuple(rigged.bones.names[bone] for bone in shared.added.tolist())
    known = (*part.bones.names, *names)
    parents = tuple(known[above] for above in shared.parents.tolist())
    twice = next((name for name in names if name in part.taken), None)
    if twice is not None:
        raise zo.MeshError(
            "The armature of '{target}' has another bone '{bone}', which does not move the part: rename that of the "
            "source.",
            target=pair.target_name,
            bone=twice,
        )
    at_rest = replace(mapped, source=rigged.rest, target=part.rest)
    moved = move_bones(part.rig, at_rest, rigged.rest, part.rest)
    chosen = [moved.names.index(name) for name in names]
    heads, tails, upright = (each[chosen] for each in (moved.heads, moved.tails, moved.upright))
    wearers = (pair.target_name,) * len(names)
    return shared, OutfitBones(names, parents, np.stack([heads, tails], axis=1), upright, wearers, part.bones.names)


def _weights_with(part: _Part, shared: SharedBones, names: Sequence[str]) -> tuple[Attribute, Attribute]:
    """The vertex groups of a target, and the same with weights of shared and added bones in the part; others stay."""
    groups, labels = part.groups, list(part.groups.labels)
    labels += [name for name in (*part.bones.names, *names) if name not in labels]
    before = renumber_bones(csr_array(groups.values), np.arange(len(groups.labels)), len(labels))
    columns = np.array([labels.index(name) for name in (*part.bones.names, *names)])
    received = renumber_bones(shared.weights, columns, len(labels))
    inside, is_bone = part.mask > 0, np.isin(np.arange(len(labels)), columns)
    others = diags_array((~is_bone).astype(float))  # of groups that are not bones
    outside = diags_array((~inside).astype(float))
    after = csr_array(outside @ before + diags_array(inside.astype(float)) @ (before @ others + received))
    given = replace(groups, values=before, labels=tuple(labels))
    return given, replace(given, values=after)
