# SPDX-License-Identifier: GPL-3.0-or-later
"""Mannequins with humanoid bones."""

from __future__ import annotations

import numpy as np
from mannequins import PARTS, Mannequin
from scipy.sparse import csr_array

from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.transfer.rigging.bone_pairs import Skeleton
from zoomout_core.transfer.rigging.joint_map import RiggedBody

SIDES = {"L": "left", "R": "right"}
BONES = {
    "torso": "hips",
    "head": "head",
    "upper arm": "UpperArm",
    "forearm": "LowerArm",
    "hand": "Hand",
    "thigh": "UpperLeg",
    "shin": "LowerLeg",
    "foot": "Foot",
}
NAMES = [*PARTS, "neck"]  # a bone that has no partner, and moves a part of the head
HUMANOID = {SIDES.get(side, "") + BONES[part]: name for name in PARTS for part, _, side in [name.partition(".")]}
HEADS = np.array([joint for _, joint, _, _ in PARTS.values()] + [(0, 0, 1.65)], dtype=float)
PARENTS = np.array([NAMES.index(above) if above else -1 for above, *_ in PARTS.values()] + [NAMES.index("head")])


def rigged(body: Mannequin, at_rest: Mannequin, build: tuple[float, float, float] = (1, 1, 1)) -> RiggedBody:
    """A mannequin with its bones, given the same one at rest."""
    heads = HEADS * build
    for bone, name in enumerate(PARTS):
        chosen = body.part == name
        heads[bone] = procrustes(at_rest.surface.vertices[chosen], body.surface.vertices[chosen])(heads[bone])
    column = np.array([NAMES.index(name) for name in body.part])
    column[(body.part == "head") & (body.keys[:, 2] > 0.05)] = NAMES.index("neck")
    weights = csr_array((np.ones(len(column)), (np.arange(len(column)), column)), shape=(len(column), len(NAMES)))
    return RiggedBody(body.surface, Skeleton(NAMES, PARENTS, heads, HUMANOID), weights)
