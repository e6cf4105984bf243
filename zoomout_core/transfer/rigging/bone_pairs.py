# SPDX-License-Identifier: GPL-3.0-or-later
"""Partners of bones in another armature, by name, place and hierarchy."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers

# Maximum distance of a bone from its partner, as a share of the extent of all bones: wider than the error of joints
# that are moved along a map (2 % of the height), and narrower than a hand.
REACH = 0.04
# Heads closer to each other than this share of it are in the same place.
SHARED = 0.002
SIDES = {"left": "l", "right": "r"}


class Skeleton(NamedTuple):
    """The bones of an armature."""

    names: Sequence[str]
    parents: Integers  # (b,) numbers of their parents, -1 for none
    heads: Floats  # (b, 3)


def pair_bones(
    bones: Skeleton, others: Skeleton, size: float, known: Mapping[str, str] = MappingProxyType({})
) -> dict[str, str]:
    """Partners of bones in another armature that stands in the same place.

    Bones of the same name are partners, then those whose names differ in spelling only, then those that are
    mutually nearest among the rest, and then the parents of partners: bones often share their heads.

    Args:
        bones: the bones.
        others: those of the other armature.
        size: extent of the body.
        known: partners that are known, such as by the humanoid bones of avatars.

    Returns:
        Names of the others by those of the bones; bones without a partner are left out.
    """
    free = set(others.names) - set(known.values())
    pairs = {**known, **{name: name for name in bones.names if name not in known and name in free}}
    spelled = {_spelling(name): name for name in reversed(others.names) if name not in pairs.values()}
    for name in bones.names:
        if name not in pairs and _spelling(name) in spelled:
            pairs[name] = spelled.pop(_spelling(name))
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


def _spelling(name: str) -> str:
    """A name without prefix before a colon, case, separators and long words for sides."""
    words = re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name.rpartition(":")[2]).lower())
    return " ".join(sorted(SIDES.get(word, word) for word in words))
