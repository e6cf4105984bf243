# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses that play a rig: joints turned to extremes, poses about moved joints, the most different of a range."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.spectral.sampling import farthest_points
from zoomout_core.tuning import Tuning, tuned

# Maximum number of frames of an animation that are played: as many as there are poses of extreme joints.
MAX_FRAMES = 12

# A limb begins at a joint this far from the middle, and its chain reaches this much farther: shares of the height.
ASIDE, LONG = 0.02, 0.15
# Elbows and knees have chains of this length below them, as a share of the height; fingers and toes do not.
JOINTED = 0.1
# Degrees of gentle poses: limbs swing and are lifted to the sides, elbows and knees bend, each joint of the trunk bows.
SWING, LIFT, BEND, BOW = 30.0, 60.0, 20.0, 10.0


@dataclass(frozen=True)
class PoseTuning(Tuning, set_by="everywhere"):
    """How bones are turned to extremes."""

    angle: float = tuned(30.0, "degrees", 0, 180)  # by which each bone is turned against its parent


POSES = PoseTuning()


def extreme_turns(parents: Integers) -> Floats:
    """(f, b, 3) rotation vectors of bones against their parents (b,), in radians about the axes of the world at rest.

    In half of the poses all bones turn in the same sense, in the others every second one along a chain turns back.
    """
    depth = np.zeros(len(parents), dtype=np.int64)
    for bone in parents_first(parents):
        depth[bone] = 0 if parents[bone] < 0 else depth[parents[bone]] + 1
    turns = []
    for axis, sign, alternating in product(np.eye(3), (1.0, -1.0), (False, True)):
        sense = np.where(alternating & (depth % 2 == 1), -sign, sign)
        turns.append(np.radians(POSES.angle) * sense[:, None] * axis)
    return np.array(turns)


def extreme_poses(heads: Floats, parents: Integers) -> Floats:
    """(f, b, 3, 4) transforms of bones with heads (b, 3) from the rest pose to the poses of `extreme_turns`."""
    return np.array([pose_of_turns(turns, heads, parents) for turns in extreme_turns(parents)])


class Limbs(NamedTuple):
    """The limbs of a rig, which x points across.

    Attributes:
        side: (b,) 1 for joints at positive x, -1 at negative x, 0 in the middle.
        root: (b,) whether a limb begins at a joint.
        inner: (b,) whether a joint is in a limb, beyond its root, such as an elbow or a finger.
        reach: (b,) the length of the longest chain below a joint, as a share of the height.
    """

    side: Floats
    root: Booleans
    inner: Booleans
    reach: Floats


def find_limbs(heads: Floats, parents: Integers, up: int) -> Limbs:
    """Find the limbs of a rig with joints at heads (b, 3), by the number of the axis that points up."""
    middle, height = float(np.median(heads[:, 0])), max(float(np.ptp(heads[:, up])), SMALLEST)
    side = np.where(np.abs(heads[:, 0] - middle) > ASIDE * height, np.sign(heads[:, 0] - middle), 0)
    order, reach = parents_first(parents), np.zeros(len(heads))
    for joint in reversed(order):
        above = parents[joint]
        if above >= 0:
            length = float(np.linalg.norm(heads[joint] - heads[above])) / height
            reach[above] = max(reach[above], reach[joint] + length)
    root, inner = np.zeros((2, len(heads)), dtype=bool)
    for joint in order:
        above = parents[joint]
        inner[joint] = above >= 0 and (root[above] or inner[above])
        root[joint] = not inner[joint] and side[joint] and reach[joint] > LONG
    return Limbs(side, root, inner, reach)


def gentle_poses(heads: Floats, parents: Integers, up: int) -> Floats:
    """(f, b, 3, 4) transforms of joints with heads (b, 3) to poses that bodies often take, without extremes.

    Limbs swing to the front and back and to the sides, elbows and knees bend, and the trunk bends.

    Args:
        heads: the joints; x points across.
        parents: (b,) numbers of their parents.
        up: number of the axis that points up.
    """
    limbs = find_limbs(heads, parents, up)
    trunk = ~limbs.root & ~limbs.inner & (limbs.side == 0) & (parents >= 0)
    across, ahead = 0, 3 - up
    turned = (
        (limbs.root * limbs.side, SWING, (across, ahead)),
        (limbs.root * limbs.side, LIFT, (ahead,)),
        (limbs.inner & (limbs.reach > JOINTED), BEND, (across,)),
        (trunk, BOW, (across,)),
    )
    turns = []
    for joints, angle, axes in turned:
        for axis in axes:
            for sign in (1, -1):
                turn = np.zeros((len(heads), 3))
                turn[:, axis] = sign * np.radians(angle) * joints
                turns.append(pose_of_turns(turn, heads, parents))
    return np.array(turns)


def extend_poses(poses: Floats, parents: Integers) -> Floats:
    """(f, b, 3, 4) poses of joints with parents (b,), of which the first ones have poses (f, a, 3, 4).

    The others move with their parents.
    """
    count = poses.shape[1]
    every = np.tile(np.eye(3, 4), (len(poses), len(parents), 1, 1))
    every[:, :count] = poses
    for joint in parents_first(parents):
        if joint >= count and parents[joint] >= 0:
            every[:, joint] = every[:, parents[joint]]
    return every


def pose_of_turns(turns: Floats, heads: Floats, parents: Integers) -> Floats:
    """(b, 3, 4) transforms of bones from the rest pose to one in which each is turned against its parent.

    Args:
        turns: (b, 3) rotation vectors, in radians about the axes of the world at rest.
        heads: (b, 3) the place that each bone turns about, at rest.
        parents: (b,) the number of each bone's parent, -1 for none.
    """
    transforms = np.zeros((len(parents), 3, 4))
    matrices = Rotation.from_rotvec(turns).as_matrix()
    for bone in parents_first(parents):
        own = np.column_stack([matrices[bone], heads[bone] - matrices[bone] @ heads[bone]])
        if parents[bone] >= 0:
            above = transforms[parents[bone]]
            own = np.column_stack([above[:, :3] @ own[:, :3], above[:, :3] @ own[:, 3] + above[:, 3]])
        transforms[bone] = own
    return transforms


def poses_about(poses: Floats, heads: Floats, moved: Floats, parents: Integers) -> Floats:
    """The same poses (f, b, 3, 4) of bones that turn about other heads.

    Args:
        poses: transforms of the bones from rest.
        heads: (b, 3) the places that these turn about, at rest.
        moved: (b, 3) the places that the bones of the result turn about.
        parents: (b,) the number of each bone's parent, -1 for none.
    """
    found = np.empty_like(poses)
    for bone in parents_first(parents):
        above = parents[bone]
        turn, place = poses[:, bone, :, :3], np.einsum("fxy,y->fx", poses[:, bone, :, :3], heads[bone])
        place += poses[:, bone, :, 3]
        head = moved[bone] + place - heads[bone]
        if above >= 0:  # it moves with the bone above, as before
            inverse = np.linalg.inv(poses[:, above, :, :3])
            own = np.einsum("fxy,fy->fx", inverse, place - poses[:, above, :, 3]) - heads[bone] + moved[bone]
            head = np.einsum("fxy,fy->fx", found[:, above, :, :3], own) + found[:, above, :, 3]
        found[:, bone, :, :3] = turn
        found[:, bone, :, 3] = head - np.einsum("fxy,y->fx", turn, moved[bone])
    return found


def distinct_poses(poses: Floats, heads: Floats, count: int = MAX_FRAMES) -> Floats:
    """The `count` most different poses of (f, b, 3, 4), by where they move bones that turn about heads (b, 3)."""
    if not len(poses):
        return poses
    corners = heads[:, None] + np.ptp(heads, axis=0).max() * np.vstack([np.zeros(3), np.eye(3)])
    moved = np.einsum("fbxy,bcy->fbcx", poses[..., :3], corners) + poses[:, :, None, :, 3]
    chosen = farthest_points(moved.reshape(len(poses), -1), count)
    return np.asarray(poses[np.sort(chosen)])


def parents_first(parents: Integers) -> list[int]:
    """The numbers of bones with parents (b,), -1 for none, in an order in which parents precede children."""
    order: list[int] = []
    known = set[int]()
    for start in range(len(parents)):
        chain, bone = list[int](), start
        while bone >= 0 and bone not in known:
            known.add(bone)
            chain.append(bone)
            bone = int(parents[bone])
        order += reversed(chain)
    return order
