# SPDX-License-Identifier: GPL-3.0-or-later
"""Humanoid bones by their names in common rigs, as one table.

The first line of each block names the conventions of its columns. A row is one bone, named as in VRM 1.0. In a cell,
`*` is a side: the row stands for two bones, left and right. `/` separates other names of the same bone, and `=` repeats
the cell on the left. A cell is empty if rigs of the convention have no such bone. Case, separators, prefixes and the
place of the side do not count.

Sources: the schemas of VRM 0.x and 1.0, Unity's `HumanBodyBones`, characters of Mixamo and VRoid Studio, Rigify's human
metarig, the mannequins of Unreal Engine 4 and 5, Biped of 3ds Max, Cats for VRChat, MakeHuman's default rig, and
MikuMikuDance.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from unicodedata import normalize

TABLE = """
vrm 1               | unity              | mixamo       | rigify        | unreal 5    | unreal 4
hips                | =                  | Hips         | spine         | pelvis      | =
spine               | =                  | Spine        | spine.001     | spine_01    | =
chest               | =                  | Spine1       | spine.002     | spine_03    | spine_02
upperChest          | =                  | Spine2       | spine.003     | spine_05    | spine_03
neck                | =                  | Neck         | spine.004     | neck_01     | =
head                | =                  | Head         | spine.006     | head        | =
*Eye                | =                  | *Eye         |               |             |
*Shoulder           | =                  | *Shoulder    | shoulder.*    | clavicle_*  | =
*UpperArm           | =                  | *Arm         | upper_arm.*   | upperarm_*  | =
*LowerArm           | =                  | *ForeArm     | forearm.*     | lowerarm_*  | =
*Hand               | =                  | *Hand        | hand.*        | hand_*      | =
*UpperLeg           | =                  | *UpLeg       | thigh.*       | thigh_*     | =
*LowerLeg           | =                  | *Leg         | shin.*        | calf_*      | =
*Foot               | =                  | *Foot        | foot.*        | foot_*      | =
*Toes               | *Toes/*Toe         | *ToeBase     | toe.*         | ball_*      | =
*ThumbMetacarpal    | *ThumbProximal     | *HandThumb1  | thumb.01.*    | thumb_01_*  | =
*ThumbProximal      | *ThumbIntermediate | *HandThumb2  | thumb.02.*    | thumb_02_*  | =
*ThumbDistal        | =                  | *HandThumb3  | thumb.03.*    | thumb_03_*  | =
*IndexProximal      | =                  | *HandIndex1  | f_index.01.*  | index_01_*  | =
*IndexIntermediate  | =                  | *HandIndex2  | f_index.02.*  | index_02_*  | =
*IndexDistal        | =                  | *HandIndex3  | f_index.03.*  | index_03_*  | =
*MiddleProximal     | =                  | *HandMiddle1 | f_middle.01.* | middle_01_* | =
*MiddleIntermediate | =                  | *HandMiddle2 | f_middle.02.* | middle_02_* | =
*MiddleDistal       | =                  | *HandMiddle3 | f_middle.03.* | middle_03_* | =
*RingProximal       | =                  | *HandRing1   | f_ring.01.*   | ring_01_*   | =
*RingIntermediate   | =                  | *HandRing2   | f_ring.02.*   | ring_02_*   | =
*RingDistal         | =                  | *HandRing3   | f_ring.03.*   | ring_03_*   | =
*LittleProximal     | =                  | *HandPinky1  | f_pinky.01.*  | pinky_01_*  | =
*LittleIntermediate | =                  | *HandPinky2  | f_pinky.02.*  | pinky_02_*  | =
*LittleDistal       | =                  | *HandPinky3  | f_pinky.03.*  | pinky_03_*  | =

vrm 1               | vroid      | biped     | cats            | makehuman    | mmd
hips                | Hips       | Pelvis    | Hips            | root         | 下半身
spine               | Spine      | Spine     | Spine           | spine04      | 上半身
chest               | Chest      | Spine1    | Chest           | spine02      | 上半身2
upperChest          | UpperChest | Spine2    | Upper Chest     | spine01      | 上半身3
neck                | Neck       | Neck      | Neck            | neck01       | 首
head                | Head       | Head      | Head            | head         | 頭
*Eye                | *FaceEye   |           | *Eye            | eye.*        | *目
*Shoulder           | *Shoulder  | *Clavicle | *shoulder       | clavicle.*   | *肩
*UpperArm           | *UpperArm  | *UpperArm | *arm            | upperarm01.* | *腕
*LowerArm           | *LowerArm  | *Forearm  | *elbow          | lowerarm01.* | *ひじ
*Hand               | *Hand      | *Hand     | *wrist          | wrist.*      | *手首
*UpperLeg           | *UpperLeg  | *Thigh    | *leg            | upperleg01.* | *足
*LowerLeg           | *LowerLeg  | *Calf     | *knee           | lowerleg01.* | *ひざ
*Foot               | *Foot      | *Foot     | *ankle          | foot.*       | *足首
*Toes               | *ToeBase   | *Toe0     | *toe            |              | *つま先
*ThumbMetacarpal    | *Thumb1    | *Finger0  | Thumb0_*        | finger1-1.*  | *親指0
*ThumbProximal      | *Thumb2    | *Finger01 | Thumb1_*        | finger1-2.*  | *親指1
*ThumbDistal        | *Thumb3    | *Finger02 | Thumb2_*        | finger1-3.*  | *親指2
*IndexProximal      | *Index1    | *Finger1  | IndexFinger1_*  | finger2-1.*  | *人指1
*IndexIntermediate  | *Index2    | *Finger11 | IndexFinger2_*  | finger2-2.*  | *人指2
*IndexDistal        | *Index3    | *Finger12 | IndexFinger3_*  | finger2-3.*  | *人指3
*MiddleProximal     | *Middle1   | *Finger2  | MiddleFinger1_* | finger3-1.*  | *中指1
*MiddleIntermediate | *Middle2   | *Finger21 | MiddleFinger2_* | finger3-2.*  | *中指2
*MiddleDistal       | *Middle3   | *Finger22 | MiddleFinger3_* | finger3-3.*  | *中指3
*RingProximal       | *Ring1     | *Finger3  | RingFinger1_*   | finger4-1.*  | *薬指1
*RingIntermediate   | *Ring2     | *Finger31 | RingFinger2_*   | finger4-2.*  | *薬指2
*RingDistal         | *Ring3     | *Finger32 | RingFinger3_*   | finger4-3.*  | *薬指3
*LittleProximal     | *Little1   | *Finger4  | LittleFinger1_* | finger5-1.*  | *小指1
*LittleIntermediate | *Little2   | *Finger41 | LittleFinger2_* | finger5-2.*  | *小指2
*LittleDistal       | *Little3   | *Finger42 | LittleFinger3_* | finger5-3.*  | *小指3
"""
# A rig follows a convention if it has at least this many of its bones: a torso and two limbs. Single names, such as
# Head, occur in all kinds of rigs.
MIN_BONES = 10
# Prefixes of all bones of a rig; Rigify's deform bones come first where a name occurs with several.
PREFIX = re.compile(r"^(?:.*:|(?:def|org)[-_]|valvebiped\.|bip\d*[ _]|j_(?:bip|adj)_(?:c_)?)+", re.IGNORECASE)
DEFORMING = "DEF-"
SIDES = {"left": "l", "right": "r", "左": "l", "右": "r"}
LEFT, RIGHT = "left", "right"


def spelling(name: str) -> str:
    """A name without prefix, case, separators and long words for sides: sorted words, and then numbers in order."""
    words = re.sub(r"([a-z])([A-Z])", r"\1 \2", PREFIX.sub("", normalize("NFKC", name))).lower()
    for long, short in SIDES.items():
        words = re.sub(long if not long.isascii() else rf"(?<![a-z]){long}(?![a-z])", f" {short} ", words)
    numbers = re.findall(r"\d+", words)  # `finger1-2` and `finger2-1` are different bones
    return " ".join([*sorted(re.findall(r"[^\W\d_]+", words)), *numbers])


def humanoid_bones(names: Sequence[str]) -> dict[str, str]:
    """Names of bones by their names in VRM 1.0, such as `leftUpperArm`; none if they follow no known convention."""
    ordered = sorted(dict.fromkeys(names), key=lambda name: not name.startswith(DEFORMING))
    best: dict[str, str] = {}
    for convention in _conventions():
        found: dict[str, str] = {}
        for name in ordered:
            bone = convention.get(spelling(name))
            if bone is not None:
                found.setdefault(bone, name)
        if len(found) > len(best):
            best = found
    return best if len(best) >= MIN_BONES else {}


@cache
def _conventions() -> tuple[dict[str, str], ...]:
    """For each convention the names in VRM 1.0 by spelled names."""
    conventions = list[dict[str, str]]()
    for block in TABLE.strip().split("\n\n"):
        head, *rows = ([cell.strip() for cell in line.split("|")] for line in block.splitlines())
        of_block = tuple(dict[str, str]() for _ in head)
        for bone, *others in rows:
            cell = bone
            for convention, own in zip(of_block, (bone, *others), strict=True):
                cell = cell if own == "=" else own
                for name in filter(None, cell.split("/")):
                    for side in (LEFT, RIGHT) if "*" in bone else ("",):
                        convention[spelling(name.replace("*", f" {side} "))] = bone.replace("*", side)
        conventions += of_block
    return tuple(conventions)
