# SPDX-License-Identifier: GPL-3.0-or-later
"""Partners of bones in another armature, as humanoid bones, by name, place and hierarchy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.rigging.humanoid import humanoid_bones, spelling

# Maximum distance of a bone from its partner, as a share of the extent of all bones. It is more than the error of
# joints moved along a map (2 % of the height), and less than the width of a hand.
REACH = 0.04
# Heads closer to each other than this share of it are in the same place.
SHARED = 0.002


class Skeleton(NamedTuple):
    """The bones of an armature."""

    names: Sequence[str]
    parents: Integers  # (b,) numbers of their parents, -1 for none
    heads: Floats  # (b, 3)
    humanoid: Mapping[str, str] | None = None  # names by those in VRM 1.0, as in an avatar file; None if not known


def pair_bones(bones: Skeleton, others: Skeleton, size: float) -> dict[str, str]:
    """Partners of bones in another armature that stands in the same place.

    The same humanoid bones are partners, by the file or by the names of common rigs. Then come bones of the same name,
    those whose names differ in spelling only, those that are mutually nearest among the rest, and the parents of
    partners: bones often share their heads.

    Args:
        bones: the bones.
        others: those of the other armature.
        size: extent of the body.

    Returns:
        Names of the others by those of the bones; bones without a partner are left out.
    """
    pairs = same_humanoid(bones, others)
    free = set(others.names) - set(pairs.values())
    pairs |= {name: name for name in bones.names if name not in pairs and name in free}
    spelled = {spelling(name): name for name in reversed(others.names) if name not in pairs.values()}
    for name in bones.names:
        if name not in pairs and spelling(name) in spelled:
            pairs[name] = spelled.pop(spelling(name))
    pairs |= _nearest(bones, others, pairs, size)
    number, other_number = ({name: i for i, name in enumerate(each.names)} for each in (bones, others))
    # Bones that are added to the list are looked at in turn.
    for child in (climbing := list(pairs)):
        above, other_above = bones.parents[number[child]], others.parents[other_number[pairs[child]]]
        if above < 0 or other_above < 0:
            continue
        parent, other_parent = bones.names[above], others.names[other_above]
        if parent not in pairs and other_parent not in pairs.values():
            pairs[parent] = other_parent
            climbing.append(parent)
    return pairs


def same_humanoid(bones: Skeleton, others: Skeleton) -> dict[str, str]:
    """Pairs of bones that are the same humanoid bone."""
    one, other = (
        {bone: name for bone, name in found.items() if name in each.names}
        for each in (bones, others)
        for found in [humanoid_bones(each.names) if each.humanoid is None else each.humanoid]
    )
    return {name: other[bone] for bone, name in one.items() if bone in other}


def _nearest(bones: Skeleton, others: Skeleton, pairs: dict[str, str], size: float) -> dict[str, str]:
    """Pairs of bones that are mutually nearest, and close, among those without a partner."""
    rest = np.flatnonzero([name not in pairs for name in bones.names])
    free = np.flatnonzero([name not in pairs.values() for name in others.names])
    rest, free = rest[_is_alone(bones.heads[rest], size)], free[_is_alone(others.heads[free], size)]
    if not len(rest) or not len(free):
        return {}
    found = cKDTree(others.heads[free]).query(bones.heads[rest])
    distance, nearest = (np.asarray(each) for each in found)
    back = np.asarray(cKDTree(bones.heads[rest]).query(others.heads[free])[1])
    mutual = (distance < REACH * size) & (back[nearest] == np.arange(len(rest)))
    return {bones.names[rest[number]]: others.names[free[nearest[number]]] for number in np.flatnonzero(mutual)}


def _is_alone(heads: Floats, size: float) -> Booleans:
    """(b,) whether no other head is in the same place."""
    if len(heads) < 2:
        return np.ones(len(heads), dtype=bool)
    return np.asarray(cKDTree(heads).query(heads, 2)[0])[:, 1] > SHARED * size
