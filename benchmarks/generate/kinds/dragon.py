# SPDX-License-Identifier: GPL-3.0-or-later
"""Dragons: four legs, two wings, a long neck, horns and a long tail."""

from __future__ import annotations

from zoomout_core.samples.implicit import Ellipsoid, Limb, Solid
from zoomout_core.samples.skeletons import BoneRow, chain_of_bones

from .kind import Build, Kind
from .quadruped import LEG_BONES, LEG_BUILDS, LEG_REACH, LEGS_LEFT, TRUNK, TRUNK_BONES, TRUNK_REACH

NECK_AND_HEAD: list[Solid] = [
    Limb(
        ((0, -0.42, 0.86, 0.12), (0, -0.60, 1.04, 0.09), (0, -0.70, 1.26, 0.075), (0, -0.80, 1.42, 0.07)),
        blend=0.08,
    ),
    Ellipsoid((0, -0.87, 1.45), (0.095, 0.13, 0.085), blend=0.05),
    Limb(((0, -0.94, 1.43, 0.07), (0, -1.12, 1.38, 0.058)), blend=0.05),
]
TAIL: list[Solid] = [
    Limb(
        (
            (0, 0.42, 0.84, 0.12),
            (0, 0.66, 0.74, 0.085),
            (0, 0.90, 0.62, 0.06),
            (0, 1.12, 0.58, 0.042),
            (0, 1.32, 0.62, 0.03),
        ),
        blend=0.06,
    ),
    Ellipsoid((0, 1.38, 0.64), (0.085, 0.09, 0.028), blend=0.03),
]
HORN_LEFT: list[Solid] = [
    Limb(((0.06, -0.82, 1.51, 0.032), (0.10, -0.72, 1.60, 0.024), (0.12, -0.62, 1.64, 0.013)), blend=0.02),
]
WING_LEFT: list[Solid] = [
    Limb(((0.09, -0.24, 0.92, 0.07), (0.30, -0.26, 1.08, 0.045), (0.52, -0.30, 1.20, 0.038)), blend=0.05),
    Limb(((0.52, -0.30, 1.20, 0.038), (0.82, -0.20, 1.20, 0.028), (1.08, -0.02, 1.18, 0.02)), blend=0.03),
    Limb(((0.52, -0.30, 1.20, 0.036), (0.72, -0.02, 1.19, 0.028), (0.86, 0.20, 1.17, 0.02)), blend=0.03),
    Limb(((0.52, -0.30, 1.20, 0.036), (0.54, 0.02, 1.17, 0.028), (0.55, 0.26, 1.13, 0.02)), blend=0.03),
    Ellipsoid((0.62, -0.08, 1.19), (0.20, 0.19, 0.025), blend=0.04),
    Ellipsoid((0.82, -0.06, 1.185), (0.16, 0.13, 0.022), blend=0.04),
    Limb(((0.50, -0.20, 1.19, 0.025), (0.40, 0.0, 1.14, 0.025), (0.36, 0.08, 1.11, 0.022)), blend=0.08),
]

DRAGON = Kind(
    middle=TRUNK + NECK_AND_HEAD + TAIL,
    left=LEGS_LEFT + HORN_LEFT + WING_LEFT,
    middle_bones=[
        *TRUNK_BONES,
        *chain_of_bones("neck", "chest", (0, -0.40, 0.86), (0, -0.58, 1.02), (0, -0.69, 1.24), (0, -0.80, 1.42)),
        BoneRow("head", "neck_3", (0, -0.80, 1.42), (0, -0.94, 1.44)),
        BoneRow("head_muzzle", "head", (0, -0.94, 1.44), (0, -1.17, 1.37)),
        *chain_of_bones(
            "tail", "hips", (0, 0.44, 0.84), (0, 0.66, 0.74), (0, 0.90, 0.62), (0, 1.12, 0.58), (0, 1.46, 0.65)
        ),
    ],
    left_bones=[
        *LEG_BONES,
        BoneRow("horn.L", "head", (0.062, -0.81, 1.515), (0.123, -0.60, 1.645)),
        BoneRow("wing_1.L", "chest", (0.10, -0.245, 0.93), (0.30, -0.26, 1.08)),
        BoneRow("wing_2.L", "wing_1.L", (0.30, -0.26, 1.08), (0.52, -0.28, 1.20)),
        BoneRow("wing_tip.L", "wing_2.L", (0.52, -0.28, 1.20), (1.09, -0.01, 1.18)),
        BoneRow("wing_mid.L", "wing_2.L", (0.54, -0.22, 1.195), (0.87, 0.22, 1.17)),
        BoneRow("wing_end.L", "wing_2.L", (0.52, -0.18, 1.19), (0.55, 0.28, 1.13)),
    ],
    reach={
        **TRUNK_REACH,
        **LEG_REACH,
        "neck_1": ((-25, 25), (-8, 8), (-20, 20)),
        "neck_2": ((-25, 25), (-8, 8), (-20, 20)),
        "neck_3": ((-20, 25), (-8, 8), (-20, 20)),
        "head": ((-20, 30), (-12, 12), (-25, 25)),
        **{f"tail_{i}": ((-18, 20), (0, 0), (-30, 30)) for i in (1, 2, 3, 4)},
        "wing_1.L": ((-20, 20), (-30, 25), (-15, 20)),
        "wing_2.L": ((-15, 15), (-30, 30), (-10, 25)),
        "wing_tip.L": ((-10, 10), (-15, 25), (-10, 10)),
        "wing_mid.L": ((-8, 8), (-10, 20), (-3, 3)),
        "wing_end.L": ((-10, 10), (-8, 8), (-3, 3)),
    },
    builds=[
        Build(("head",), (0.9, 1.45)),
        Build(("horn",), (1.0, 1.4), (0.8, 1.7)),
        Build(("neck",), (0.9, 1.25), (0.75, 1.25)),
        Build(("hips", "spine", "chest"), (0.85, 1.2), (0.85, 1.15)),
        Build(("tail",), (0.9, 1.3), (0.7, 1.2)),
        Build(("wing",), (1.0, 1.3), (0.75, 1.25)),
        *LEG_BUILDS,
    ],
)
