# SPDX-License-Identifier: GPL-3.0-or-later
"""Limbs of a skeleton, from its hierarchy, its bones' names and the sides in these names.

A chain of sided bones that starts at the middle of the body is one limb (an arm, a leg, a wing), however
many bones it has; bones of the middle are distinguished by their names.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Floats, Integers

SIDE = re.compile(r"(?:^|[ ._-])(left|right|l|r)(?:$|[ ._-])", re.IGNORECASE)
# Names of bones in the middle; the first matching pattern counts.
MIDDLE = (
    ("tail", re.compile("tail", re.IGNORECASE)),
    ("torso", re.compile("root|body|hip|pelvis|spine|abdomen|torso|chest|thorax|back", re.IGNORECASE)),
    ("head", re.compile("head|neck|jaw|mouth|tongue|eye|ear|hair|beak|horn", re.IGNORECASE)),
)
# Small sided bones of the head; and control bones that are children of the root.
OF_HEAD = re.compile("ear|eye|cheek|brow|horn|lip", re.IGNORECASE)
PULLED = re.compile("foot|hand|^ik|^ff|^pt|pole|target", re.IGNORECASE)
PAIR_OF_LEGS = re.compile("front|back|fore|hind", re.IGNORECASE)


class Skeleton(NamedTuple):
    """Bones, parents before children.

    Attributes:
        names: (b,) of the bones.
        parent: (b,) the index of each bone's parent, -1 at roots.
        head: (b, 3) the bones' heads at rest.
    """

    names: tuple[str, ...]
    parent: Integers
    head: Floats


class Limbs(NamedTuple):
    """The limbs and sides of a skeleton's bones.

    Attributes:
        limb: (b,) the name of each bone's limb.
        side: (b,) 1 on the left, -1 on the right, 0 in the middle.
    """

    limb: tuple[str, ...]
    side: Integers


def limbs_of(skeleton: Skeleton) -> Limbs:
    """The limb and the side of each bone."""
    limb, side = [""] * len(skeleton.names), np.zeros(len(skeleton.names), dtype=np.int64)
    for i, parent in enumerate(skeleton.parent.tolist()):
        if parent >= 0 and side[parent]:  # the top of a chain decides
            limb[i], side[i] = limb[parent], side[parent]
            continue
        side[i] = _side(skeleton, i)
        begun_by = _sided_limb if side[i] else _middle_limb
        limb[i] = begun_by(skeleton.names[i], limb[parent] if parent >= 0 else "torso")
    return Limbs(_with_pulled_bones(skeleton, limb, side), side)


def _side(skeleton: Skeleton, bone: int) -> int:
    """The side in a bone's name, or, if there is none, the common side of all its descendants."""
    own = _named_side(skeleton.names[bone])
    clear = re.search(r"\.\d+$", skeleton.names[bone]) is None
    below = [_named_side(skeleton.names[i]) for i in np.flatnonzero(skeleton.parent == bone)]
    if own and not clear and below and len(set(below)) == 1 and below[0]:
        return below[0]  # a copy of the other side's bone that got a number instead of a new name
    return own


def _named_side(name: str) -> int:
    found = SIDE.search(name)
    return 0 if found is None else 1 if found[1].lower().startswith("l") else -1


def _sided_limb(name: str, above: str) -> str:
    """The limb of a chain that begins with a sided bone; its name includes the side."""
    return "head" if above == "head" and OF_HEAD.search(name) else name


def _middle_limb(name: str, above: str) -> str:
    return next((limb for limb, pattern in MIDDLE if pattern.search(name)), above)


def _with_pulled_bones(skeleton: Skeleton, limb: list[str], side: Integers) -> tuple[str, ...]:
    """The limbs, with feet and the like that are children of the root added to the nearest limb of their side."""
    pulled = np.array([bool(PULLED.search(name)) for name in limb])
    has_child = np.isin(np.arange(len(limb)), skeleton.parent)
    ends = np.flatnonzero(~pulled & ~has_child & (side != 0) & (np.array(limb) != "head"))
    joined: dict[str, str] = {}
    for i in np.flatnonzero(pulled):
        near = ends[side[ends] == side[i]]
        called_alike = near[[_pair_of_legs(limb[j]) == _pair_of_legs(limb[i]) for j in near]]
        near = called_alike if len(called_alike) else near
        if limb[i] in joined or len(near) == 0:
            continue
        nearest = near[np.argmin(np.linalg.norm(skeleton.head[near] - skeleton.head[i], axis=1))]
        joined[limb[i]] = limb[nearest]
    return tuple(joined.get(name, name) for name in limb)


def _pair_of_legs(name: str) -> str:
    found = PAIR_OF_LEGS.search(name)
    return "" if found is None else found[0].lower()
