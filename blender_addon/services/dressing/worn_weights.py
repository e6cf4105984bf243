# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights of worn objects that follow the weights of the body that they are copied to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from bpy.types import Context
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.transfer import Attribute, Dressed, PosedBody, WeightedBody, clear_in_poses, follow_weights
from zoomout_core.transfer.rigging.poses import extend_poses, gentle_poses
from zoomout_core.transfer.rigging.skinning import renumber_bones

from ... import mesh_data
from ...mesh_data import Bones, ObjectPair, OutfitBones, Worn
from ...scene.pair import evaluated_sources, find_mesh

# The axis that points up in Blender.
UP = 2


class Change(NamedTuple):
    """Weights of a copy before and after they follow the body, with the same labels: bones of the target's armature."""

    before: Attribute
    after: Attribute


@dataclass(frozen=True, eq=False)
class GroupWeights:
    """Vertex groups of two bodies, and of the objects that one of them wears.

    Attributes:
        source: those of the source.
        target: those of the target.
        worn: those of each worn object; None where it has none.
    """

    source: Attribute
    target: Attribute
    worn: list[Attribute | None]


def read_group_weights(context: Context, pair: ObjectPair, worn: Sequence[Worn]) -> GroupWeights:
    """Read the vertex groups of a pair and of worn objects."""
    with evaluated_sources(context, pair) as sources:
        of_source, _ = mesh_data.read_joined_weights(sources)
    target = find_mesh(context, pair.target_name)
    of_worn = list[Attribute | None]()
    for each in worn:
        obj = context.scene.objects[each.name]
        found = mesh_data.read_weights(obj, obj.data) if obj.type == "MESH" else None
        of_worn.append(found if found is not None and found.values.nnz else None)
    return GroupWeights(of_source, mesh_data.read_weights(target, target.data), of_worn)


@dataclass(frozen=True, eq=False)
class BoneNames:
    """Names of the bones by which weights follow.

    Attributes:
        partners: for each bone of the source's body its name in the target's armature.
        own: the outfit's own bones.
        target: the target's bones.
    """

    partners: Mapping[str, str]
    own: Sequence[str]
    target: Sequence[str]


@dataclass(frozen=True, eq=False)
class BodyPair:
    """The source's body and the target, at rest.

    Attributes:
        body: the source without worn parts.
        is_body: (n_s,) which of the source's vertices the body has.
        shape: (n, 3) the body's vertices in the target's shape.
        target: the target.
    """

    body: zo.Surface
    is_body: Booleans
    shape: Floats
    target: zo.Surface


def follow_groups(
    weights: GroupWeights, names: BoneNames, bodies: BodyPair, worn: Sequence[Worn], fitted: Sequence[Floats]
) -> list[Change | None]:
    """How the weights of copies follow the target's, see `follow_weights`.

    Args:
        weights: the vertex groups.
        names: the bones.
        bodies: the body that the copies are taken from, and the target.
        worn: the objects.
        fitted: for each (n, 3) its vertices on the target.

    Returns:
        The change for each object; None for those that keep their weights.
    """
    labels = tuple(dict.fromkeys([*names.target, *names.partners.values(), *names.own]))
    of_worn = {**names.partners, **{name: name for name in names.own}}
    of_source = csr_array(_by_label(weights.source, names.partners, labels)[bodies.is_body])
    before = WeightedBody(bodies.body, of_source)
    after = WeightedBody(bodies.target, _by_label(weights.target, {name: name for name in names.target}, labels))
    changes: list[Change | None] = [None] * len(worn)
    if not before.weights.nnz or not after.weights.nnz:
        return changes
    bound = {
        number: given
        for number, each in enumerate(weights.worn)
        if each is not None and (given := _by_label(each, of_worn, labels)).nnz
    }
    shapes, places = [worn[number].shape for number in bound], [fitted[number] for number in bound]
    masks = [worn[number].mask for number in bound]
    followed = follow_weights(before, after, shapes, places, list(bound.values()), masks, bodies.shape)
    for (number, was), now in zip(bound.items(), followed, strict=True):
        used = np.union1d(was.indices, now.indices)
        named = replace(weights.source, labels=tuple(labels[column] for column in used))
        changes[number] = Change(*(replace(named, values=csr_array(each[:, used])) for each in (was, now)))
    return changes


def clear_copies(
    dressed: Dressed,
    changes: Sequence[Change | None],
    weights: GroupWeights,
    bones: Bones,
    outfit: OutfitBones,
    pairs: Mapping[str, str],
) -> Dressed:
    """Displace copies a little, so that they stay outside of the target's skin in poses, see `clear_in_poses`.

    Args:
        dressed: the fitted objects.
        changes: their new weights.
        weights: the vertex groups.
        bones: the bones that move the target, at rest.
        outfit: the outfit's own bones, which follow the bones above them.
        pairs: names of the target's bones by those of the source's.
    """
    if all(each is None for each in changes):
        return dressed
    labels = (*bones.names, *outfit.names)
    number = {name: column for column, name in enumerate(labels)}
    above = [number.get(name, number.get(pairs.get(name, ""), -1)) for name in outfit.parents]
    parents = np.concatenate([bones.parents, np.array(above, dtype=np.int64)])
    poses = extend_poses(gentle_poses(bones.heads, bones.parents, UP), parents)
    given = [None if each is None else normalise(weights_of_bones(each.after, labels)) for each in changes]
    return clear_in_poses(dressed, PosedBody(normalise(weights_of_bones(weights.target, labels)), poses), given)


def weights_of_bones(weights: Attribute, names: Sequence[str]) -> csr_array:
    """(n, b) the weights of the groups that have the names of bones."""
    return _by_label(weights, {name: name for name in names}, names)


def _by_label(weights: Attribute, names: Mapping[str, str], labels: Sequence[str]) -> csr_array:
    """(n, labels) the weights of the groups that have a name among these labels; others are left out."""
    number = {label: column for column, label in enumerate(labels)}
    numbers = np.array([number.get(names.get(group, ""), -1) for group in weights.labels], dtype=np.int64)
    return renumber_bones(weights.values, numbers, len(labels))
