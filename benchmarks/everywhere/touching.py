# SPDX-License-Identifier: GPL-3.0-or-later
"""MakeHuman bodies in poses in which feet, hands, arms or fingers touch, and the limbs that maps may confuse there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.transfer.rigging.poses import pose_of_turns

Bodies: TypeAlias = Any  # the class of `clothes.py`, which comes with the data
# Distance at which two limbs count as touching, in centimetres, and the number of steps in which a pose approaches it.
GAP, STEPS = 0.3, 60
# A vertex belongs to a limb if the bones of that limb have this share of its weights.
OF_LIMB = 0.9
SIDES = ("L", 1), ("R", -1)
UPPER_LIP = ("oris03.L", "oris03.R", "oris04.L", "oris04.R", "oris05", "oris06")
LOWER_LIP = ("oris01", "oris02", "oris06.L", "oris06.R", "oris07.L", "oris07.R", "special04", "jaw")
# Degrees by which each leg is turned inwards, at most.
MAX_TURN = 16.0


def below(bodies: Bodies, bone: str) -> Integers:
    """The indices of a bone and of all its descendants."""
    parent = dict(zip(bodies.bone_names, bodies.bone_parents, strict=True))

    def descends(name: str) -> bool:
        return name == bone or (name in parent and descends(parent[name]))

    return np.flatnonzero([descends(name) for name in bodies.bone_names])


def arms_and_legs(bodies: Bodies) -> Integers:
    """(n,) the limb of each vertex: 1 for the left arm, 2 for the left leg, negative on the right, else 0."""
    return number_limbs(
        bodies.weights,
        {
            sign * kind: below(bodies, f"{bone}.{side}")
            for side, sign in SIDES
            for kind, bone in enumerate(("upperarm01", "upperleg01"), start=1)
        },
    )


def fingers(bodies: Bodies) -> Integers:
    """(n,) the number of each vertex's finger, from 1 to 5, negative on the right, else 0."""
    numbers = range(1, 6)
    return number_limbs(
        bodies.weights, {sign * i: below(bodies, f"finger{i}-1.{side}") for side, sign in SIDES for i in numbers}
    )


def lips(bodies: Bodies) -> Integers:
    """(n,) 1 on the upper lip, 2 on the lower one and the jaw, else 0."""
    names = bodies.bone_names
    groups = {number: [names.index(bone) for bone in lip] for number, lip in ((1, UPPER_LIP), (2, LOWER_LIP))}
    return number_limbs(bodies.weights, groups)


def number_limbs(weights: Floats, groups: Mapping[int, Sequence[int] | Integers]) -> Integers:
    """(n,) the number of the group of bones that moves each vertex, 0 for none, from weights (n, b)."""
    limb = np.zeros(len(weights), dtype=np.int64)
    for number, bones in groups.items():
        limb[weights[:, bones].sum(axis=1) > OF_LIMB] = number
    return limb


def feet_together(bodies: Bodies, build: str) -> Floats:
    """(n, 3) a body with both legs turned inwards until the feet touch."""
    leg = arms_and_legs(bodies)
    low = bodies.vertices(build)[:, 1] < np.quantile(bodies.vertices(build)[:, 1], 0.05)

    def pose(share: float) -> Floats:
        angle = np.radians(share * MAX_TURN)
        return _turn(bodies, build, {f"upperleg01.{side}": (0, 0, -sign * angle) for side, sign in SIDES})

    return _until_touching(pose, (leg == 2) & low, (leg == -2) & low)


def arms_at_sides(bodies: Bodies, build: str) -> Floats:
    """(n, 3) a body with straight arms that hang down, and touch its sides or thighs."""

    def pose(share: float) -> Floats:
        down = {}
        for side, sign in SIDES:
            _, own = _arm(bodies, build, side)
            aim = _blend(own, np.array([-0.1 * sign, -1.0, 0.0]), share)
            down[side] = aim, aim
        return _aim_arms(bodies, build, down)

    arm = np.abs(arms_and_legs(bodies)) == 1
    return _until_touching(pose, arm, _trunk(bodies))


def hands_on_hips(bodies: Bodies, build: str) -> Floats:
    """(n, 3) a body with its hands on its hips."""
    hips = bodies.heads(build)[bodies.bone_names.index("upperleg01.L")]

    def pose(share: float) -> Floats:
        aims = {}
        for side, sign in SIDES:
            shoulder, own = _arm(bodies, build, side)
            upper = np.array([0.8 * sign, -0.75, -0.35]) / np.linalg.norm([0.8, 0.75, 0.35])
            elbow = shoulder + np.linalg.norm(own) * upper
            hand = np.array([sign * ((1 - share) * 35 + 8), hips[1] + 8, 6.0])
            aims[side] = upper, hand - elbow
        return _aim_arms(bodies, build, aims)

    arm = np.abs(arms_and_legs(bodies)) == 1
    return _until_touching(pose, arm, _trunk(bodies))


def crossed_arms(bodies: Bodies, build: str) -> Floats:
    """(n, 3) a body with its forearms crossed before its chest, one above the other, until one touches."""

    def pose(share: float) -> Floats:
        aims = {}
        for side, sign in SIDES:
            shoulder, own = _arm(bodies, build, side)
            upper = np.array([0.25 * sign, -0.8, 0.5 + 0.4 * (1 - share)])
            upper /= np.linalg.norm(upper)
            elbow = shoulder + np.linalg.norm(own) * upper
            ahead = (1 - share) * 25 + (6 + 10 * (1 - share) if side == "L" else 0)
            aims[side] = upper, np.array([-6.0 * sign, elbow[1] + (12 if side == "L" else 2), 14 + ahead]) - elbow
        return _aim_arms(bodies, build, aims)

    limb = arms_and_legs(bodies)
    return _until_touching(pose, limb == 1, (limb == -1) | _trunk(bodies))


def closed_fingers(bodies: Bodies, build: str) -> Floats:
    """(n, 3) a body with its fingers side by side, until two touch."""
    heads, names = bodies.heads(build), bodies.bone_names

    def pose(share: float) -> Floats:
        turns = {}
        for side, _ in SIDES:
            base = [heads[names.index(f"finger{i}-1.{side}")] for i in range(2, 6)]
            along = [heads[names.index(f"finger{i}-3.{side}")] - base[i - 2] for i in range(2, 6)]
            middle = (base[1] + base[2]) / 2 + 1.5 * (along[1] + along[2]) / 2
            for i, start, own in zip(range(2, 6), base, along, strict=True):
                turns[f"finger{i}-1.{side}"] = _rotation_between(own, _blend(own, middle - start, share))
        return _turn(bodies, build, turns)

    finger = fingers(bodies)
    return _until_touching(pose, finger == 2, finger == 3)


def closed_lips(bodies: Bodies, build: str) -> Floats:
    """(n, 3) a body at rest, whose lips touch."""
    return np.asarray(bodies.vertices(build))


# Poses, each with the limbs that a map may confuse.
POSES: dict[str, tuple[Callable[[Bodies, str], Floats], Callable[[Bodies], Integers]]] = {
    "arms at sides": (arms_at_sides, arms_and_legs),
    "hands on hips": (hands_on_hips, arms_and_legs),
    "crossed arms": (crossed_arms, arms_and_legs),
    "fingers together": (closed_fingers, fingers),
    "lips": (closed_lips, lips),
}
ALL_POSES = {"feet together": (feet_together, arms_and_legs), **POSES}


def _trunk(bodies: Bodies) -> Booleans:
    """(n,) vertices of torso and legs, away from the arms."""
    arms = np.concatenate([below(bodies, f"clavicle.{side}") for side, _ in SIDES])
    return np.asarray(bodies.weights[:, arms].sum(axis=1) < 0.01)


def _arm(bodies: Bodies, build: str, side: str) -> tuple[Floats, Floats]:
    """The place of a shoulder at rest, and the vector from there to the elbow."""
    shoulder, elbow = (
        bodies.heads(build)[bodies.bone_names.index(f"{n}.{side}")] for n in ("upperarm01", "lowerarm01")
    )
    return shoulder, elbow - shoulder


def _aim_arms(bodies: Bodies, build: str, aims: Mapping[str, tuple[Floats, Floats]]) -> Floats:
    """(n, 3) a body whose upper arms and forearms point in given directions, by side."""
    heads, names, turns = bodies.heads(build), bodies.bone_names, {}
    for side, (upper, lower) in aims.items():
        elbow, wrist = (heads[names.index(f"{name}.{side}")] for name in ("lowerarm01", "wrist"))
        turns[f"upperarm01.{side}"] = _rotation_between(_arm(bodies, build, side)[1], upper)
        back = Rotation.from_rotvec(turns[f"upperarm01.{side}"]).inv().apply(lower)
        turns[f"lowerarm01.{side}"] = _rotation_between(wrist - elbow, back)
    return _turn(bodies, build, turns)


def _turn(bodies: Bodies, build: str, turns: Mapping[str, Sequence[float] | Floats]) -> Floats:
    """(n, 3) a body with some bones turned against their parents, by rotation vectors."""
    names = bodies.bone_names
    parents = np.array([names.index(parent) if parent else -1 for parent in bodies.bone_parents])
    vectors = np.array([turns.get(name, (0, 0, 0)) for name in names], dtype=np.float64)
    transforms = pose_of_turns(vectors, bodies.heads(build), parents)
    weights = csr_array(bodies.weights / bodies.weights.sum(axis=1, keepdims=True))
    return transform_points(blend_matrices(transforms, weights), bodies.vertices(build))


def _until_touching(pose: Callable[[float], Floats], one: Booleans, other: Booleans) -> Floats:
    """(n, 3) the first of the poses between 0 and 1 in which two sets of vertices (n,) touch, otherwise the last."""
    for share in np.linspace(0, 1, STEPS):
        posed = pose(share)
        if np.asarray(cKDTree(posed[one]).query(posed[other])[0]).min() < GAP:
            break
    return posed


def _blend(own: Floats, aim: Floats, share: float) -> Floats:
    """A direction between two."""
    return np.asarray((1 - share) * own / np.linalg.norm(own) + share * aim / np.linalg.norm(aim))


def _rotation_between(one: Floats, other: Floats) -> Floats:
    """The rotation vector of the smallest rotation from one direction to another."""
    return np.asarray(Rotation.align_vectors([other], [one])[0].as_rotvec())
