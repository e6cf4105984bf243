# SPDX-License-Identifier: GPL-3.0-or-later
"""Add bones of a second source, such as those of a face, to a part of a target that already has bones.

Bones of both rigs with the same humanoid bone or name are shared, and receive the source's weights. Bones of the source
that mostly move the part, but have no partner in it, are added. Their parent is the partner of the nearest bone above
them, or the first bone of the part if that partner moves another part. Weights of the source's other bones are replaced
by the target's own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.transfer.rigging.bone_pairs import Skeleton, pair_bones
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.transfer.rigging.skinning import renumber_bones

# A bone belongs to a part if more than this share of the area that it moves is in the part.
MOSTLY = 0.5


class SharedBones(NamedTuple):
    """The bones of a target, followed by those that a source adds to it."""

    partners: Integers  # (b,) the target's bone that is shared with each bone of the source, -1 for none
    added: Integers  # (a,) numbers of the source's bones that are added, each after its parent
    parents: Integers  # (a,) the parent of each of these: a bone of the target or an added one
    weights: csr_array  # (n_t, t + a) weights of all bones, which sum to one


def share_bones(
    bones: Skeleton, others: Skeleton, weights: csr_array, own: csr_array, mask: Floats, areas: Floats
) -> SharedBones:
    """Find the bones of a source that a target shares, and those to add to it, see the module.

    Args:
        bones: the bones of the source; their heads are not used.
        others: the bones of the target.
        weights: (n_t, b) weights of the source's bones at the vertices of the target.
        own: (n_t, t) weights of the target's bones.
        mask: (n_t,) share of the source's weights, in [0, 1].
        areas: (n_t,) areas of the vertices.
    """
    count, counted = len(others.names), mask * areas
    inside, inside_own = (_mostly_in(counted, areas, each) for each in (weights, own))
    partners = _partners(bones, others, inside, inside_own)
    added = [bone for bone in parents_first(bones.parents) if inside[bone] and partners[bone] < 0]
    columns = partners.copy()
    columns[added] = count + np.arange(len(added))
    # Possible parents of added bones: those that move the part.
    above_part = np.where(columns >= count, columns, np.where((partners >= 0) & inside_own[partners], partners, -1))
    first = _first_bone(others.parents, int(np.argmax(own.T @ counted)), inside_own)
    parents = np.array([_nearest_above(bone, bones.parents, above_part, first) for bone in added], dtype=np.int64)
    received = renumber_bones(weights, columns, count + len(added))
    before = renumber_bones(own, np.arange(count), count + len(added))
    shares = np.asarray(received.sum(axis=1)).ravel()  # the rest is of bones that are neither shared nor added
    mixed = diags_array(mask) @ received + diags_array(1 - mask * shares) @ before
    return SharedBones(partners, np.array(added, dtype=np.int64), parents, normalise(csr_array(mixed)))


def _mostly_in(counted: Floats, areas: Floats, weights: csr_array) -> Booleans:
    """(b,) the bones that mostly move a part, from the areas (n,) of vertices in the part and of all vertices."""
    moved = weights.T @ areas
    return np.asarray((moved > 0) & (weights.T @ counted > MOSTLY * moved))


def _partners(bones: Skeleton, others: Skeleton, inside: Booleans, inside_own: Booleans) -> Integers:
    """(b,) the target's bone that is shared with each bone of the source, -1 for none.

    A bone that moves the part is not shared with a bone elsewhere that happens to have its name.
    """
    number = {name: bone for bone, name in reversed(list(enumerate(others.names)))}
    pairs = pair_bones(bones, others, 0)  # by names alone: no two heads are nearer to each other than that
    found = np.array([number[pairs[name]] if name in pairs else -1 for name in bones.names], dtype=np.int64)
    return np.where(inside & ~inside_own[found], -1, found)


def _first_bone(parents: Integers, bone: int, inside: Booleans) -> int:
    """The first bone of a part, searched upwards from one of its bones."""
    while parents[bone] >= 0 and inside[parents[bone]]:
        bone = int(parents[bone])
    return bone


def _nearest_above(bone: int, parents: Integers, numbers: Integers, first: int) -> int:
    """The number of the nearest bone above a bone that has one (others have -1), or the first bone if none has."""
    above = int(parents[bone])
    while above >= 0 and numbers[above] < 0:
        above = int(parents[above])
    return first if above < 0 else int(numbers[above])
