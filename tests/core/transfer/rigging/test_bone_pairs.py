# SPDX-License-Identifier: GPL-3.0-or-later
"""Partners of bones in another armature."""

from __future__ import annotations

import numpy as np

from zoomout_core.transfer import Skeleton
from zoomout_core.transfer.rigging import bone_pairs

HEADS = np.array([[0, 0, 1.0], [0.2, 0, 1.4], [-0.2, 0, 1.4], [0, 0, 1.6]])


def pair(names: list[str], heads: np.ndarray, others: list[str], other_heads: np.ndarray) -> dict[str, str]:
    """Partners of bones without parents."""
    bones, there = (Skeleton(each, np.full(len(each), -1), at) for each, at in ((names, heads), (others, other_heads)))
    return bone_pairs.pair_bones(bones, there, 1.7)


def test_equal_names_are_paired_first_at_any_place() -> None:
    assert pair(["hips", "head"], HEADS[:2], ["head", "hips"], HEADS[:2]) == {"hips": "hips", "head": "head"}


def test_spelling_does_not_matter() -> None:
    names = ["Arm.L", "arm_right", "UpperLeg_L"]
    others = ["mixamorig:LeftUpperLeg", "RightArm", "leftArm"]
    assert pair(names, HEADS[:3], others, HEADS[:3] + 10) == dict(zip(names, others[::-1], strict=True))


def test_other_bones_are_paired_if_close_and_mutually_nearest() -> None:
    off = HEADS + 0.02
    names = ["a", "b", "c", "d"]
    assert pair(names, HEADS, ["w", "x", "y", "z"], off) == dict(zip(names, "wxyz", strict=True))
    assert pair(["a", "twist"], np.stack([HEADS[0], HEADS[0] + 0.01]), ["w"], HEADS[:1]) == {"a": "w"}
    assert pair(["a"], HEADS[:1], ["w"], HEADS[:1] + 0.3) == {}
    assert pair([], HEADS[:0], ["w"], HEADS[:1]) == {}


def test_parents_of_partners_are_partners() -> None:
    heads = HEADS[[0, 0, 0, 1, 2]]
    parents = np.array([-1, 0, 0, 1, 2])
    bones = Skeleton(["root", "pelvis.L", "pelvis.R", "leg.L", "leg.R"], parents, heads)
    others = Skeleton(["J_0", "J_1", "J_2", "J_3", "J_4"], parents, heads)
    found = bone_pairs.pair_bones(bones, others, 1.7)
    assert found == dict(zip(bones.names, others.names, strict=True))


def test_known_partners_come_first() -> None:
    """Such as by humanoid bones, which may contradict the names."""
    heads = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 2]])
    parents = np.array([-1, 0, 1])
    bones, others = Skeleton(["a", "b", "c"], parents, heads), Skeleton(["b", "a", "c"], parents, heads)
    assert bone_pairs.pair_bones(bones, others, 2.0) == {"a": "a", "b": "b", "c": "c"}
    assert bone_pairs.pair_bones(bones, others, 2.0, {"a": "b"}) == {"a": "b", "c": "c", "b": "a"}
