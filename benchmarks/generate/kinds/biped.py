# SPDX-License-Identifier: GPL-3.0-or-later
"""Two-legged people, as cartoons draw them: three fingers, large feet."""

from __future__ import annotations

from zoomout_core.samples.implicit import Ellipsoid, Limb, Solid
from zoomout_core.samples.skeletons import BoneRow

from .kind import Build, Kind, Reach

CHEST: list[Solid] = [
    Ellipsoid((0, 0.005, 1.27), (0.185, 0.115, 0.17), blend=0.08),
    Limb(((0, 0.01, 1.38, 0.075), (0, 0.0, 1.54, 0.058)), blend=0.05),
]
BELLY: list[Solid] = [
    Ellipsoid((0, -0.01, 1.10), (0.15, 0.12, 0.16), blend=0.08),
    Ellipsoid((0, 0.01, 0.95), (0.165, 0.125, 0.12), blend=0.08),
]
HEAD: list[Solid] = [
    Ellipsoid((0, 0.0, 1.71), (0.14, 0.155, 0.165), blend=0.05),
    Ellipsoid((0, -0.07, 1.61), (0.085, 0.085, 0.07), blend=0.06),  # jaw
    Limb(((0, -0.145, 1.69, 0.018), (0, -0.19, 1.655, 0.026)), blend=0.03),  # nose
]
EYE_LEFT = Ellipsoid((0.058, -0.122, 1.735), (0.036, 0.036, 0.04))
HEAD_LEFT: list[Solid] = [
    Ellipsoid((0.155, 0.015, 1.69), (0.03, 0.04, 0.06), blend=0.02),
]
ARM_LEFT: list[Solid] = [
    Limb(((0.14, 0.0, 1.36, 0.075), (0.39, 0.01, 1.28, 0.052), (0.62, -0.005, 1.21, 0.038)), blend=0.06),
    Ellipsoid((0.69, -0.01, 1.19), (0.075, 0.062, 0.032), blend=0.03),
    Limb(((0.72, -0.05, 1.185, 0.026), (0.83, -0.09, 1.17, 0.02)), blend=0.015),
    Limb(((0.74, -0.01, 1.182, 0.027), (0.86, -0.012, 1.165, 0.021)), blend=0.015),
    Limb(((0.72, 0.03, 1.183, 0.026), (0.83, 0.065, 1.168, 0.02)), blend=0.015),
    Limb(((0.66, -0.055, 1.185, 0.027), (0.69, -0.13, 1.165, 0.023)), blend=0.02),  # thumb
]
LEG_LEFT: list[Solid] = [
    Limb(((0.105, 0, 0.92, 0.098), (0.12, -0.012, 0.52, 0.063), (0.125, 0.015, 0.10, 0.046)), blend=0.05),
    Ellipsoid((0.122, 0.03, 0.38), (0.055, 0.06, 0.13), blend=0.04),  # calf
    Limb(((0.125, 0.045, 0.055, 0.052), (0.135, -0.09, 0.05, 0.052), (0.14, -0.16, 0.042, 0.042)), blend=0.04),
]

MIDDLE_BONES = [
    BoneRow("hips", None, (0, 0.01, 0.92), (0, 0.0, 1.04)),
    BoneRow("spine", "hips", (0, 0.0, 1.04), (0, 0.0, 1.18)),
    BoneRow("chest", "spine", (0, 0.0, 1.18), (0, 0.005, 1.40)),
    BoneRow("neck", "chest", (0, 0.005, 1.40), (0, 0.0, 1.54)),
    BoneRow("head", "neck", (0, 0.0, 1.54), (0, 0, 1.86)),
]
ARM_BONES = [
    BoneRow("shoulder.L", "chest", (0.03, 0, 1.36), (0.15, 0, 1.355)),
    BoneRow("upper_arm.L", "shoulder.L", (0.15, 0, 1.355), (0.39, 0.01, 1.28)),
    BoneRow("forearm.L", "upper_arm.L", (0.39, 0.01, 1.28), (0.62, -0.005, 1.21)),
    BoneRow("hand.L", "forearm.L", (0.62, -0.005, 1.21), (0.72, -0.01, 1.187)),
    BoneRow("hand_thumb.L", "hand.L", (0.665, -0.06, 1.184), (0.692, -0.145, 1.162)),
    BoneRow("hand_index.L", "hand.L", (0.74, -0.055, 1.183), (0.845, -0.095, 1.168)),
    BoneRow("hand_middle.L", "hand.L", (0.76, -0.01, 1.18), (0.875, -0.012, 1.163)),
    BoneRow("hand_ring.L", "hand.L", (0.74, 0.035, 1.181), (0.845, 0.07, 1.166)),
]
LEG_BONES = [
    BoneRow("thigh.L", "hips", (0.105, 0, 0.90), (0.12, -0.012, 0.52)),
    BoneRow("shin.L", "thigh.L", (0.12, -0.012, 0.52), (0.125, 0.015, 0.11)),
    BoneRow("foot.L", "shin.L", (0.125, 0.015, 0.11), (0.135, -0.09, 0.055)),
    BoneRow("foot_toes.L", "foot.L", (0.135, -0.09, 0.055), (0.142, -0.2, 0.042)),
]

ARM_REACH: dict[str, Reach] = {
    "shoulder.L": ((0, 0), (-8, 8), (-8, 8)),
    "upper_arm.L": ((-25, 25), (-60, 40), (-55, 20)),
    "forearm.L": ((-20, 20), (-30, 10), (-70, -10)),
    "hand.L": ((-25, 25), (-35, 35), (-15, 15)),
    "hand_thumb.L": ((0, 0), (-15, 15), (-10, 10)),
    "hand_index.L": ((0, 0), (0, 40), (-4, 4)),
    "hand_middle.L": ((0, 0), (0, 40), (-4, 4)),
    "hand_ring.L": ((0, 0), (0, 40), (-4, 4)),
}
LEG_REACH: dict[str, Reach] = {
    "thigh.L": ((-65, 25), (-28, 0), (-10, 10)),
    "shin.L": ((5, 70), (0, 0), (0, 0)),
    "foot.L": ((-25, 20), (-8, 8), (-10, 10)),
    "foot_toes.L": ((-15, 5), (0, 0), (0, 0)),
}
TRUNK_REACH: dict[str, Reach] = {
    "spine": ((-8, 22), (-12, 12), (-18, 18)),
    "chest": ((-8, 18), (-12, 12), (-18, 18)),
    "neck": ((-10, 15), (-10, 10), (-20, 20)),
    "head": ((-18, 15), (-12, 12), (-30, 30)),
}
ARM_BUILDS = [
    Build(("upper_arm", "forearm"), (0.85, 1.3), (0.85, 1.2)),
    Build(("hand",), (0.95, 1.35)),
]

BIPED = Kind(
    middle=CHEST + BELLY + HEAD,
    left=HEAD_LEFT + ARM_LEFT + LEG_LEFT,
    middle_bones=MIDDLE_BONES,
    left_bones=ARM_BONES + LEG_BONES,
    reach={"hips": ((-10, 15), (-12, 12), (-180, 180)), **TRUNK_REACH, **ARM_REACH, **LEG_REACH},
    builds=[
        Build(("head",), (0.95, 1.5)),
        Build(("neck",), (0.9, 1.15), (0.8, 1.1)),
        Build(("hips", "spine"), (0.9, 1.3), (0.9, 1.1)),
        Build(("chest", "shoulder"), (0.9, 1.2), (0.9, 1.1)),
        Build(("thigh", "shin"), (0.85, 1.25), (0.75, 1.1)),
        Build(("foot",), (0.9, 1.4)),
        *ARM_BUILDS,
    ],
    eye=EYE_LEFT,
    dress=(("chest", "spine", "shoulder", "upper_arm"), ("hips", "thigh")),
)
