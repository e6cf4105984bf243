# SPDX-License-Identifier: GPL-3.0-or-later
"""Four-legged beasts, somewhere between a dog and a horse."""

from __future__ import annotations

from zoomout_core.samples.implicit import Ellipsoid, Limb, Solid
from zoomout_core.samples.skeletons import BoneRow, chain_of_bones

from .kind import Build, Kind, Reach

TRUNK: list[Solid] = [
    Limb(((0, -0.36, 0.80, 0.165), (0, 0.0, 0.82, 0.15), (0, 0.36, 0.83, 0.155)), blend=0.08),
]
NECK_AND_HEAD: list[Solid] = [
    Limb(((0, -0.42, 0.88, 0.115), (0, -0.58, 1.07, 0.085), (0, -0.68, 1.20, 0.08)), blend=0.08),
    Ellipsoid((0, -0.74, 1.25), (0.095, 0.13, 0.10), blend=0.05),
    Limb(((0, -0.82, 1.22, 0.07), (0, -0.97, 1.15, 0.052)), blend=0.05),  # muzzle
]
EAR_LEFT: list[Solid] = [
    Limb(((0.06, -0.68, 1.32, 0.036), (0.10, -0.665, 1.42, 0.03), (0.115, -0.66, 1.48, 0.014)), blend=0.03),
]
LEGS_LEFT: list[Solid] = [
    Limb(((0.11, -0.36, 0.72, 0.095), (0.13, -0.335, 0.42, 0.055), (0.13, -0.36, 0.10, 0.04)), blend=0.06),
    Limb(((0.13, -0.36, 0.055, 0.052), (0.135, -0.44, 0.048, 0.048)), blend=0.03),
    Limb(
        ((0.11, 0.36, 0.74, 0.125), (0.13, 0.31, 0.47, 0.07), (0.13, 0.43, 0.28, 0.043), (0.13, 0.40, 0.09, 0.04)),
        blend=0.06,
    ),
    Limb(((0.13, 0.40, 0.055, 0.052), (0.135, 0.31, 0.048, 0.048)), blend=0.03),
]
TAIL: list[Solid] = [
    Limb(
        ((0, 0.46, 0.90, 0.055), (0, 0.62, 0.90, 0.045), (0, 0.78, 0.80, 0.042), (0, 0.90, 0.64, 0.028)),
        blend=0.05,
    ),
]

TRUNK_BONES = [
    BoneRow("hips", None, (0, 0.38, 0.84), (0, 0.14, 0.83)),
    BoneRow("spine", "hips", (0, 0.14, 0.83), (0, -0.12, 0.82)),
    BoneRow("chest", "spine", (0, -0.12, 0.82), (0, -0.40, 0.86)),
]
NECK_BONES = [
    BoneRow("neck_1", "chest", (0, -0.40, 0.86), (0, -0.54, 1.02)),
    BoneRow("neck_2", "neck_1", (0, -0.54, 1.02), (0, -0.67, 1.20)),
    BoneRow("head", "neck_2", (0, -0.67, 1.20), (0, -0.83, 1.22)),
    BoneRow("head_muzzle", "head", (0, -0.83, 1.22), (0, -1.01, 1.14)),
]
TAIL_BONES = chain_of_bones("tail", "hips", (0, 0.46, 0.90), (0, 0.62, 0.90), (0, 0.78, 0.80), (0, 0.92, 0.62))
EAR_BONES = [BoneRow("ear.L", "head", (0.065, -0.68, 1.33), (0.117, -0.66, 1.49))]
LEG_BONES = [
    BoneRow("fore_upper.L", "chest", (0.11, -0.36, 0.72), (0.13, -0.335, 0.42)),
    BoneRow("fore_lower.L", "fore_upper.L", (0.13, -0.335, 0.42), (0.13, -0.36, 0.10)),
    BoneRow("fore_paw.L", "fore_lower.L", (0.13, -0.36, 0.10), (0.136, -0.48, 0.045)),
    BoneRow("hind_upper.L", "hips", (0.11, 0.36, 0.76), (0.13, 0.31, 0.47)),
    BoneRow("hind_lower.L", "hind_upper.L", (0.13, 0.31, 0.47), (0.13, 0.43, 0.28)),
    BoneRow("hind_hock.L", "hind_lower.L", (0.13, 0.43, 0.28), (0.13, 0.40, 0.10)),
    BoneRow("hind_paw.L", "hind_hock.L", (0.13, 0.40, 0.10), (0.136, 0.27, 0.045)),
]

LEG_REACH: dict[str, Reach] = {
    "fore_upper.L": ((-45, 35), (-15, 2), (-5, 5)),
    "fore_lower.L": ((-60, 0), (0, 0), (0, 0)),
    "fore_paw.L": ((-5, 35), (0, 0), (0, 0)),
    "hind_upper.L": ((-40, 35), (-15, 2), (-5, 5)),
    "hind_lower.L": ((-10, 35), (0, 0), (0, 0)),
    "hind_hock.L": ((-35, 15), (0, 0), (0, 0)),
    "hind_paw.L": ((-10, 35), (0, 0), (0, 0)),
}
TRUNK_REACH: dict[str, Reach] = {
    "hips": ((-25, 12), (-10, 10), (-180, 180)),
    "spine": ((-10, 15), (-8, 8), (-15, 15)),
    "chest": ((-10, 15), (-8, 8), (-15, 15)),
}
TAIL_REACH: dict[str, Reach] = {f"tail_{i}": ((-30, 25), (0, 0), (-25, 25)) for i in (1, 2, 3)}
LEG_BUILDS = [
    Build(("fore_upper", "fore_lower", "hind_upper", "hind_lower", "hind_hock"), (0.85, 1.35), (0.75, 1.15)),
    Build(("fore_paw", "hind_paw"), (0.9, 1.4)),
]

QUADRUPED = Kind(
    middle=TRUNK + NECK_AND_HEAD + TAIL,
    left=EAR_LEFT + LEGS_LEFT,
    middle_bones=TRUNK_BONES + NECK_BONES + TAIL_BONES,
    left_bones=EAR_BONES + LEG_BONES,
    reach={
        **TRUNK_REACH,
        **LEG_REACH,
        **TAIL_REACH,
        "neck_1": ((-25, 35), (-8, 8), (-20, 20)),
        "neck_2": ((-25, 25), (-8, 8), (-20, 20)),
        "head": ((-25, 25), (-12, 12), (-25, 25)),
        "ear.L": ((-20, 20), (-10, 25), (-10, 10)),
    },
    builds=[
        Build(("head",), (0.9, 1.5)),
        Build(("ear",), (0.9, 1.3), (0.8, 1.8)),
        Build(("neck",), (0.9, 1.25), (0.8, 1.25)),
        Build(("hips", "spine", "chest"), (0.85, 1.2), (0.85, 1.2)),
        Build(("tail",), (0.85, 1.4), (0.75, 1.4)),
        *LEG_BUILDS,
    ],
)
