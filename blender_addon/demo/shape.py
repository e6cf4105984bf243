# SPDX-License-Identifier: GPL-3.0-or-later
"""The shape of the demo's character, a little dragon.

Lengths are metres, the character faces -y and stands on z = 0, and its left is +x.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Floats
from zoomout_core.samples.implicit import Ellipsoid, Limb, Solid, both_sides, distance

# Bounding box of the character with a margin: its lowest and highest corner.
BOUNDS = np.array([[-1.0, -0.6, -0.1], [1.0, 1.1, 1.85]])

TORSO: list[Solid] = [
    Limb(((0, 0, 1.08, 0.09), (0, 0, 0.88, 0.12)), blend=0.08),
    Ellipsoid((0, 0, 0.82), (0.16, 0.13, 0.15), blend=0.08),
    Ellipsoid((0, -0.02, 0.60), (0.21, 0.19, 0.22), blend=0.1),
]
HEAD: list[Solid] = [
    Ellipsoid((0, -0.02, 1.23), (0.25, 0.22, 0.205), blend=0.04),
    Ellipsoid((0, -0.22, 1.15), (0.135, 0.15, 0.10), blend=0.07),  # muzzle
]
EYE_LEFT = Ellipsoid((0.115, -0.165, 1.30), (0.08, 0.065, 0.09), blend=0.012)
NOSTRIL_LEFT = Ellipsoid((0.05, -0.34, 1.185), (0.028, 0.028, 0.02), blend=0.02)
HEAD_LEFT: list[Solid] = [
    EYE_LEFT,
    NOSTRIL_LEFT,
    Ellipsoid((0.17, -0.10, 1.15), (0.075, 0.075, 0.065), blend=0.06),  # cheek
    Limb(
        ((0.16, 0.03, 1.34, 0.05), (0.25, 0.05, 1.46, 0.058), (0.33, 0.075, 1.57, 0.045), (0.385, 0.09, 1.66, 0.012)),
        blend=0.05,
    ),
]
ARM_LEFT: list[Solid] = [
    Limb(((0.11, 0, 0.88, 0.085), (0.34, 0.012, 0.81, 0.06), (0.56, 0, 0.755, 0.05)), blend=0.06),
    Ellipsoid((0.635, -0.005, 0.74), (0.08, 0.048, 0.075), blend=0.03),
    Limb(((0.66, -0.01, 0.785, 0.037), (0.725, -0.02, 0.85, 0.03)), blend=0.014),
    Limb(((0.68, -0.005, 0.742, 0.038), (0.795, -0.015, 0.752, 0.03)), blend=0.014),
    Limb(((0.66, -0.005, 0.695, 0.037), (0.762, -0.015, 0.645, 0.03)), blend=0.014),
    Limb(((0.615, -0.02, 0.77, 0.035), (0.575, -0.045, 0.865, 0.029)), blend=0.014),  # thumb
]
LEG_LEFT: list[Solid] = [
    Limb(((0.12, 0.0, 0.52, 0.13), (0.15, -0.02, 0.29, 0.092), (0.155, 0.02, 0.09, 0.07)), blend=0.06),
    Limb(((0.155, 0.035, 0.066, 0.066), (0.17, -0.10, 0.06, 0.06)), blend=0.03),
    Limb(((0.115, -0.10, 0.048, 0.047), (0.10, -0.17, 0.042, 0.041)), blend=0.015),
    Limb(((0.175, -0.11, 0.048, 0.047), (0.18, -0.195, 0.042, 0.041)), blend=0.015),
    Limb(((0.235, -0.09, 0.048, 0.047), (0.258, -0.155, 0.042, 0.039)), blend=0.015),
]
TAIL: list[Solid] = [
    Limb(
        (
            (0, 0.08, 0.50, 0.14),
            (0, 0.30, 0.37, 0.105),
            (0, 0.52, 0.30, 0.075),
            (0, 0.72, 0.34, 0.05),
            (0, 0.87, 0.47, 0.03),
            (0, 0.93, 0.60, 0.014),
        ),
        blend=0.06,
    ),
]

PARTS: dict[str, list[Solid]] = {
    "torso": TORSO,
    "head": HEAD + both_sides(HEAD_LEFT),
    "arm.L": ARM_LEFT,
    "arm.R": [solid.mirrored() for solid in ARM_LEFT],
    "leg.L": LEG_LEFT,
    "leg.R": [solid.mirrored() for solid in LEG_LEFT],
    "tail": TAIL,
}
SOLIDS: list[Solid] = list(chain.from_iterable(PARTS.values()))


def nearest_part(points: Floats) -> NDArray[np.str_]:
    """(n,) names of the parts that the points (n, 3) belong to."""
    return np.array(list(PARTS))[np.argmin([distance(points, solids) for solids in PARTS.values()], axis=0)]
