# SPDX-License-Identifier: GPL-3.0-or-later
"""The motion of the character in the extension's page: its poses, and those between them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

from blender_addon.demo.target import POSE

Pose = Mapping[str, tuple[float, float, float]]

# Degrees as in `demo.target.POSE`: a step with the left foot, and a wave.
STEP: Pose = {
    "spine": (4, 0, 8),
    "chest": (4, 0, 8),
    "head": (-4, 0, -10),
    "upper_arm.L": (0, 38, -38),
    "forearm.L": (0, 10, -42),
    "upper_arm.R": (0, -38, -30),
    "forearm.R": (0, -10, -22),
    "thigh.L": (-38, 0, 0),
    "shin.L": (22, 0, 0),
    "thigh.R": (24, 0, 0),
    "shin.R": (34, 0, 0),
    "foot.R": (16, 0, 0),
    "tail_1": (0, 0, 16),
    "tail_2": (4, 0, 18),
    "tail_3": (4, 0, 18),
    "tail_4": (0, 0, 14),
}
WAVE: Pose = {
    "hips": (0, -5, 0),
    "spine": (0, -5, 0),
    "chest": (-4, -6, -6),
    "neck": (0, 6, 0),
    "head": (-4, 12, 8),
    "ear.L": (0, -12, 0),
    "ear.R": (0, 12, 0),
    "shoulder.L": (0, -10, 0),
    "upper_arm.L": (0, -22, -8),
    "forearm.L": (0, -40, 0),
    "upper_arm.R": (0, -40, 10),
    "forearm.R": (0, -8, 20),
    "thigh.R": (0, 10, 0),
    "tail_1": (-8, 0, -14),
    "tail_2": (-8, 0, -18),
    "tail_3": (0, 0, -18),
}


def mirror(pose: Pose) -> Pose:
    """A pose with its sides exchanged."""
    other = str.maketrans("LR", "RL")
    return {name[:-1] + name[-1:].translate(other): (x, -y, -z) for name, (x, y, z) in pose.items()}


def leaning(pose: Pose, forearm: float, hand: float) -> Pose:
    """A pose with the left forearm and hand turned further in the picture's plane, in degrees."""
    return {**pose, "forearm.L": (0, pose["forearm.L"][1] + forearm, 0), "hand.L": (0, hand, 0)}


# The rig's motion at the end: seconds from its start, and the pose then.
MOTION: tuple[tuple[float, Pose], ...] = (
    (0.0, POSE),
    (1.0, STEP),
    (1.75, mirror(STEP)),
    (2.5, STEP),
    (3.25, mirror(STEP)),
    (4.25, WAVE),
    (4.75, leaning(WAVE, forearm=-10, hand=-12)),
    (5.25, leaning(WAVE, forearm=24, hand=16)),
    (5.75, leaning(WAVE, forearm=-10, hand=-12)),
    (6.25, leaning(WAVE, forearm=24, hand=16)),
    (7.0, POSE),
)


def pose_at(seconds: float) -> Pose:
    """The current pose of the rig."""
    for (begin, pose), (end, other) in pairwise(MOTION):
        if seconds < end:
            return between(pose, other, (seconds - begin) / (end - begin))
    return MOTION[-1][1]


def between(pose: Pose, other: Pose, share: float) -> Pose:
    """A pose interpolated between two, with zero velocity at both."""
    share = share * share * (3 - 2 * share)
    rest = (0.0, 0.0, 0.0)
    found = {}
    for name in {*POSE, *STEP, *WAVE, *mirror(STEP)}:
        (x, y, z), (to_x, to_y, to_z) = pose.get(name, rest), other.get(name, rest)
        found[name] = (x + share * (to_x - x), y + share * (to_y - y), z + share * (to_z - z))
    return found
