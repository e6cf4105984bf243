# SPDX-License-Identifier: GPL-3.0-or-later
"""Match the bodies of two avatars by their joints where the match of their shapes confuses limbs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.report.verdict import AMBER, GREEN, Verdict
from zoomout_core.messages import message, warning
from zoomout_core.transfer.rigging.joint_map import RiggedBody, SharedJoints

MATCHED_BY_JOINTS = (
    "The bodies were matched by their joints, because the match of their shapes sends {share:.0%} of the avatar to "
    "other limbs."
)
LOOK_FOR_SLIDES = "Look at the clothes: they may have slid along limbs."


class JointMatch(NamedTuple):
    """A map of two bodies by their joints, and the verdict on it."""

    surface_map: SurfaceMap
    verdict: Verdict


def match_by_joints(
    matched: SurfaceMap, level: str, read_bodies: Callable[[], tuple[RiggedBody | None, RiggedBody | None]]
) -> JointMatch | None:
    """Match two bodies by their joints if these show that the match of their shapes confuses limbs.

    Args:
        matched: the map of the shapes, from the target to the source.
        level: the level of the verdict on it. A green one is kept.
        read_bodies: reads the source and the target with their bones, None for one without any.

    Returns:
        None if the match of the shapes stays: it is green, or joints do not contradict it, or are not known.
    """
    if level == GREEN:
        return None
    source, target = read_bodies()
    joints = None if source is None or target is None else SharedJoints.of(source, target)
    if joints is None or not joints.contradict(matched):
        return None
    sentence = warning(MATCHED_BY_JOINTS, share=joints.share_on_other_limbs(matched))
    return JointMatch(joints.map(), Verdict(AMBER, sentence, message(LOOK_FOR_SLIDES)))
