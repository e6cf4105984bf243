# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands with a stump of the forearm: five fingers, and no mirror symmetry."""

from __future__ import annotations

from zoomout_core.samples.implicit import Ellipsoid, Limb, Solid
from zoomout_core.samples.skeletons import BoneRow, Point, chain_of_bones

from .kind import Build, Kind, Reach

# Knuckles of each finger from palm to tip; the palm faces -y and the fingers point up.
FINGERS: dict[str, tuple[Point, ...]] = {
    "index": ((0.17, 0, 0.72), (0.205, 0, 0.90), (0.225, 0, 1.03), (0.24, 0, 1.14)),
    "middle": ((0.06, 0, 0.75), (0.07, 0, 0.95), (0.075, 0, 1.10), (0.08, 0, 1.22)),
    "ring": ((-0.05, 0, 0.73), (-0.07, 0, 0.92), (-0.085, 0, 1.06), (-0.095, 0, 1.17)),
    "little": ((-0.15, 0, 0.68), (-0.195, 0, 0.83), (-0.22, 0, 0.93), (-0.24, 0, 1.02)),
}
THUMB: tuple[Point, ...] = ((0.15, -0.04, 0.44), (0.27, -0.08, 0.56), (0.35, -0.10, 0.68), (0.40, -0.11, 0.79))


def _finger(points: tuple[Point, ...], radius: float) -> Solid:
    widths = (1.1, 1.0, 0.92, 0.72)
    return Limb(tuple((*p, radius * w) for p, w in zip(points, widths, strict=True)), blend=0.02)


def _curl(first: Reach) -> dict[str, Reach]:
    reach: dict[str, Reach] = {}
    for name in FINGERS:
        reach |= {f"{name}_1": first, f"{name}_2": ((0, 60), (0, 0), (0, 0)), f"{name}_3": ((0, 40), (0, 0), (0, 0))}
    return reach


PALM: list[Solid] = [
    Limb(((0, 0.0, 0.0, 0.115), (0, 0, 0.16, 0.10), (0.0, 0, 0.30, 0.095)), blend=0.08),
    Ellipsoid((0.005, 0, 0.50), (0.20, 0.075, 0.24), blend=0.08),
    Limb(((0.15, 0, 0.60, 0.055), (0.06, 0, 0.65, 0.06), (-0.05, 0, 0.63, 0.058), (-0.13, 0, 0.57, 0.052)), blend=0.06),
    Ellipsoid((0.11, -0.045, 0.42), (0.08, 0.07, 0.12), blend=0.06),  # ball of the thumb
]

HAND = Kind(
    middle=PALM + [_finger(points, 0.047) for points in FINGERS.values()] + [_finger(THUMB, 0.055)],
    left=[],
    middle_bones=[
        BoneRow("arm", None, (0, 0, -0.1), (0, 0, 0.24)),
        BoneRow("palm", "arm", (0, 0, 0.24), (0.01, 0, 0.62)),
        *[bone for name, points in FINGERS.items() for bone in chain_of_bones(name, "palm", *points)],
        *chain_of_bones("thumb", "palm", *THUMB),
    ],
    left_bones=[],
    reach={
        "arm": ((-40, 40), (-40, 40), (-180, 180)),
        "palm": ((-30, 45), (-20, 20), (-15, 15)),
        **_curl(((-10, 60), (-4, 4), (0, 0))),
        "thumb_1": ((-10, 20), (-10, 10), (-20, 15)),
        "thumb_2": ((-5, 15), (-30, 5), (-10, 10)),
        "thumb_3": ((0, 10), (-35, 5), (0, 0)),
    },
    builds=[
        Build(("arm",), (0.85, 1.3), (0.8, 1.3)),
        Build(("palm",), (0.9, 1.25), (0.85, 1.15)),
        Build(("index", "middle", "ring", "little"), (0.8, 1.15), (0.75, 1.25)),
        Build(("thumb",), (0.85, 1.2), (0.75, 1.2)),
    ],
)
