# SPDX-License-Identifier: GPL-3.0-or-later
"""Partners of bones in another armature."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.transfer import Skeleton
from zoomout_core.transfer.rigging import bone_pairs
from zoomout_core.transfer.rigging.humanoid import humanoid_bones

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


def test_humanoid_bones_of_a_file_come_first() -> None:
    """They may contradict the names."""
    heads = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 2]])
    parents = np.array([-1, 0, 1])
    bones, others = Skeleton(["a", "b", "c"], parents, heads), Skeleton(["b", "a", "c"], parents, heads)
    assert bone_pairs.pair_bones(bones, others, 2.0) == {"a": "a", "b": "b", "c": "c"}
    bones, others = bones._replace(humanoid={"hips": "a", "head": "gone"}), others._replace(humanoid={"hips": "b"})
    assert bone_pairs.pair_bones(bones, others, 2.0) == {"a": "b", "c": "c", "b": "a"}


def test_names_without_latin_letters_are_different_names() -> None:
    assert pair(["腕.L"], HEADS[:1], ["足.L"], HEADS[:1] + 10) == {}
    assert pair(["腕.L", "腕.R"], HEADS[:2], ["右腕", "左腕"], HEADS[:2] + 10) == {"腕.L": "左腕", "腕.R": "右腕"}


RIGS = {
    "mixamo": "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Head mixamorig:LeftShoulder mixamorig:LeftArm "
    "mixamorig:LeftForeArm mixamorig:LeftHand mixamorig:LeftUpLeg mixamorig:LeftLeg mixamorig:LeftFoot "
    "mixamorig:LeftToeBase mixamorig:LeftHandThumb1 mixamorig:LeftHandPinky3",
    "rigify": "DEF-spine DEF-spine.001 DEF-spine.002 DEF-spine.006 DEF-shoulder.L DEF-upper_arm.L DEF-forearm.L "
    "DEF-hand.L DEF-thigh.L DEF-shin.L DEF-foot.L DEF-toe.L DEF-thumb.01.L DEF-f_pinky.03.L",
    "unreal 5": "pelvis spine_01 spine_03 head clavicle_l upperarm_l lowerarm_l hand_l thigh_l calf_l foot_l ball_l "
    "thumb_01_l pinky_03_l",
    "unity": "Hips Spine Chest Head Shoulder.L Upper_Arm.L LowerArm_L Hand.L UpperLeg.L LowerLeg.L Foot.L Toe.L "
    "Thumb_Proximal_L Little_Distal.L",
    "vrm 1": "hips spine chest head leftShoulder leftUpperArm leftLowerArm leftHand leftUpperLeg leftLowerLeg leftFoot "
    "leftToes leftThumbMetacarpal leftLittleDistal",
    "vroid": "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_Head J_Bip_L_Shoulder J_Bip_L_UpperArm J_Bip_L_LowerArm "
    "J_Bip_L_Hand J_Bip_L_UpperLeg J_Bip_L_LowerLeg J_Bip_L_Foot J_Bip_L_ToeBase J_Bip_L_Thumb1 J_Bip_L_Little3",
    "biped": "Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Head Bip01_L_Clavicle Bip01_L_UpperArm Bip01_L_Forearm "
    "Bip01_L_Hand Bip01_L_Thigh Bip01_L_Calf Bip01_L_Foot Bip01_L_Toe0 Bip01_L_Finger0 Bip01_L_Finger42",
    "cats": "Hips Spine Chest Head Left_shoulder Left_arm Left_elbow Left_wrist Left_leg Left_knee Left_ankle Left_toe "
    "Thumb0_L LittleFinger3_L",
    "mmd": "下半身 上半身 上半身2 頭 肩.L 左腕 左ひじ 左手首 左足 左ひざ 左足首 左つま先 左親指０ 小指３.L",
}


@pytest.mark.parametrize("there", RIGS)
def test_humanoid_bones_are_known_by_the_names_of_common_rigs(there: str) -> None:
    """Though Left_leg is the lower leg in one and the upper leg in another, and Spine1 a chest or a spine."""
    far = np.full((14, 3), 1e3)
    for here in RIGS:
        bones, others = RIGS[here].split(), RIGS[there].split()
        assert pair(bones, far, others[::-1], -far) == dict(zip(bones, others, strict=True)), here


def test_makehumans_bones_are_known_though_its_limbs_are_divided_and_have_no_bone_for_all_toes() -> None:
    there = [name for name in RIGS["mixamo"].split() if "Toe" not in name]
    here = ["root", "spine04", "spine02", "head", "clavicle.L", "upperarm01.L", "lowerarm01.L", "wrist.L"]
    here += ["upperleg01.L", "lowerleg01.L", "foot.L", "finger1-1.L", "finger5-3.L"]
    far = np.full((len(here) + 1, 3), 1e3)
    divided = [*here, "upperarm02.L"]
    assert pair(divided, far, there[::-1], -far[1:]) == dict(zip(here, there, strict=True))


def test_numbers_in_another_order_name_another_bone() -> None:
    assert pair(["toe1-2.L"], HEADS[:1], ["Toe2-1_L"], HEADS[:1] + 10) == {}
    assert pair(["toe1-2.L"], HEADS[:1], ["L_Toe1_2"], HEADS[:1] + 10) == {"toe1-2.L": "L_Toe1_2"}


def test_a_spine_of_three_bones_is_that_of_an_older_mannequin() -> None:
    names = [*RIGS["unreal 5"].split(), "spine_02"]
    assert humanoid_bones(names)["chest"] == "spine_02"
    assert humanoid_bones([*names, "spine_05"])["chest"] == "spine_03"


def test_a_few_known_names_are_no_humanoid_rig() -> None:
    assert humanoid_bones(["Hips", "Spine", "Head", "Tail1", "Tail2"]) == {}


def test_deform_bones_stand_for_those_of_the_same_name() -> None:
    names = RIGS["rigify"].split()
    plain = [name.replace("DEF", "ORG") for name in names]
    assert set(humanoid_bones([*plain, *names]).values()) == set(names)
