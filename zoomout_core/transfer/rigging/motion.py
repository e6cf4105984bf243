# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare the motion of a body with that of the body that its rig is from.

Both are scaled to the same length of legs, as a smaller body makes smaller steps. A foot that also slides on the source
is no fault: only differences count.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.messages import Message, enumeration, message, plural, warning
from zoomout_core.transfer.rigging.poses import parents_first

# The hips are the first joint from the root that carries this share of the skin, above this share of the height.
CARRIED, HIGH = 0.5, 0.25
# Lengths relative to the legs: maximum distance of the source's standing points from the ground, maximum distance of
# touching points in a pose, and their minimum distance at rest.
ON_GROUND, TOUCHING, FAR = 0.03, 0.06, 0.3
# Largest number of vertices of the target that are compared, and of those between which distances are measured.
MAX_POINTS, MAX_TOUCHING = 50_000, 1500
# Speeds of a cycle that walks in place, relative to the source's.
FACTORS = 0.5, 2.0
# Differences that are visible: sliding in lengths of legs per second, the others in lengths of legs.
SLIDES, SINKS, FLOATS, PARTS = 0.1, 0.05, 0.05, 0.15
# Motions that a sentence names.
NAMED = 3


@dataclass(frozen=True, eq=False)
class SkinnedBody:
    """A body that joints move.

    Attributes:
        rest: (n, 3) its vertices at rest.
        weights: (n, b) sparse weights of the joints.
        joints: (b, 3) places of the joints at rest.
    """

    rest: Floats
    weights: csr_array
    joints: Floats

    def play(self, poses: Floats) -> Floats:
        """(n, f, 3) the vertices in poses (f, b, 3, 4), which are transforms of the joints from rest."""
        count, shares = len(poses), normalise(self.weights)
        columns = poses.transpose(3, 1, 0, 2).reshape(4, -1, 3 * count)
        moved = shares @ columns[3]
        for axis in range(3):
            moved += self.rest[:, axis, None] * (shares @ columns[axis])
        return np.asarray(moved).reshape(-1, count, 3)


class PlayedMotion(NamedTuple):
    """A motion of two bodies with the same joints."""

    name: str
    step: float  # seconds between frames
    of_source: Floats  # (f, b, 3, 4) transforms of the source's joints from rest
    of_target: Floats  # (f, b, 3, 4) those of the target's


@dataclass(frozen=True)
class MotionCheck:
    """How the motion of a target differs from that of its source, in lengths of their legs.

    Attributes:
        name: name of the motion.
        sliding: mean speed along the ground, relative to the source's, of points that stand there on the source; per
            second.
        sinking: how much deeper its lowest point is below the ground than the source's, at most.
        floating: how much higher its lowest point is than the source's, while that is on the ground, or below, which
            counts as on it; at most.
        parting: how much farther apart points are that touch on the source, such as a hand and the hips, at most.
    """

    name: str
    sliding: float
    sinking: float
    floating: float
    parting: float

    @property
    def faults(self) -> tuple[Message, ...]:
        """Visible differences from the source, in words."""
        found = (
            (self.sliding > SLIDES, message("feet slide by {share:.0%} per second", share=self.sliding)),
            (self.sinking > SINKS, message("it sinks {share:.0%} into the ground", share=self.sinking)),
            (self.floating > FLOATS, message("it floats {share:.0%} above the ground", share=self.floating)),
            (self.parting > PARTS, message("touching parts come {share:.0%} apart", share=self.parting)),
        )
        return tuple(words for is_fault, words in found if is_fault)


def check_motions(
    source: SkinnedBody,
    target: SkinnedBody,
    surface_map: SurfaceMap,
    parents: Integers,
    up: Floats,
    motions: Sequence[PlayedMotion],
) -> tuple[MotionCheck, ...]:
    """Compare motions of two bodies that face the same way.

    The ground is where the lowest point of the source mostly is, relative to that at rest.

    Args:
        source: the body that the rig is from.
        target: the body with the same joints, at other places.
        surface_map: the place of each target vertex on the source.
        parents: (b,) the number of each joint's parent, -1 for none.
        up: (3,) the upward direction, of length 1.
        motions: the motions.
    """
    hips = _hips(source, parents, up)
    chosen = np.unique(np.linspace(0, len(target.rest) - 1, min(len(target.rest), MAX_POINTS)).astype(np.int64))
    target = SkinnedBody(target.rest[chosen], target.weights[chosen], target.joints)
    some = SurfaceMap(surface_map.triangle[chosen], surface_map.barycentric[chosen], surface_map.source_triangles)
    (legs, bottom), (own_legs, own_bottom) = (_stand(body, hips, up) for body in (source, target))
    at_rest = some.interpolate(source.rest) / legs
    lows = [(source.play(motion.of_source) @ up).min(axis=0) / legs - bottom for motion in motions]
    ground = float(np.median(np.concatenate(lows))) if lows else 0.0
    checks = []
    for motion in motions:
        before, after = source.play(motion.of_source) / legs, target.play(motion.of_target) / own_legs
        images = some.interpolate(before)
        low, own_low = (before @ up).min(axis=0) - bottom - ground, (after @ up).min(axis=0) - own_bottom - ground
        standing = images @ up - bottom - ground < ON_GROUND  # (n, f)
        checks.append(
            MotionCheck(
                motion.name,
                _sliding(images, after, standing, up) / motion.step,
                float((np.minimum(low, 0) - own_low).max(initial=0)),
                float((own_low - np.maximum(low, 0))[standing.any(axis=0)].max(initial=0)),
                _parting(images, after, at_rest),
            )
        )
    return tuple(checks)


def note_on_motions(checks: Iterable[MotionCheck]) -> list[Message]:
    """A sentence on the motions of a target that visibly differ from the source's; a warning if there are any."""
    checks = list(checks)
    if not checks:
        return []
    faulty = sorted((each for each in checks if each.faults), key=lambda each: -_size(each))
    if not faulty:
        return [
            plural(
                len(checks),
                "The action plays as on the source, without sliding or floating.",
                "All {count} actions play as on the source, without sliding or floating.",
            )
        ]
    worst = (message("{name}: {faults}", name=each.name, faults=enumeration(each.faults)) for each in faulty[:NAMED])
    return [
        warning(
            "Actions that play worse than on the source: {count} of {all} ({worst}; in leg lengths). Correct "
            "their keyframes, or pin the feet with inverse kinematics.",
            count=len(faulty),
            all=len(checks),
            worst=enumeration(worst, "; "),
        )
    ]


def _size(check: MotionCheck) -> float:
    """The largest difference, relative to those that are visible."""
    return max(check.sliding / SLIDES, check.sinking / SINKS, check.floating / FLOATS, check.parting / PARTS)


def _hips(body: SkinnedBody, parents: Integers, up: Floats) -> int:
    """The joint that legs hang from; -1 if there is none."""
    carried = np.asarray(body.weights.sum(axis=0), dtype=np.float64).ravel()
    order = parents_first(parents)
    for joint in reversed(order):
        if parents[joint] >= 0:
            carried[parents[joint]] += carried[joint]
    heights, joints = body.rest @ up, body.joints @ up
    is_high = joints - heights.min() > HIGH * np.ptp(heights)
    return next((each for each in order if is_high[each] and carried[each] >= CARRIED * carried.max()), -1)


def _stand(body: SkinnedBody, hips: int, up: Floats) -> tuple[float, float]:
    """The length of a body's legs, or its height if it has none; and the height of the ground, in this length."""
    heights = body.rest @ up
    bottom = float(heights.min())
    top = float(heights.max() if hips < 0 else body.joints[hips] @ up)
    legs = max(top - bottom, SMALLEST)
    return legs, bottom / legs


def _sliding(images: Floats, after: Floats, standing: Booleans, up: Floats) -> float:
    """The mean difference of the motions of (n, f, 3) points along the ground, while they stand in two frames.

    A factor is fitted, the speed at which a cycle that walks in place walks best.
    """
    still = standing[:, 1:] & standing[:, :-1]
    if not still.any():
        return 0.0
    steps, own = (np.diff(points, axis=1)[still] for points in (images, after))
    steps, own = (each - np.outer(each @ up, up) for each in (steps, own))
    factor = np.clip((steps * own).sum() / max((steps**2).sum(), SMALLEST), *FACTORS)
    return float(np.linalg.norm(own - factor * steps, axis=1).mean())


def _parting(images: Floats, after: Floats, at_rest: Floats) -> float:
    """The largest median over a frame by which points that touch on the source are farther apart; 0 without any."""
    few = np.unique(np.linspace(0, len(images) - 1, min(len(images), MAX_TOUCHING)).astype(np.int64))
    images, after, at_rest = images[few], after[few], at_rest[few]
    found = 0.0
    for frame in range(images.shape[1]):
        place, own = images[:, frame], after[:, frame]
        first, second = cKDTree(place).query_pairs(TOUCHING, output_type="ndarray").T
        far = np.linalg.norm(at_rest[first] - at_rest[second], axis=1) > FAR
        first, second = first[far], second[far]
        if len(first):
            apart, own_apart = (np.linalg.norm(each[first] - each[second], axis=1) for each in (place, own))
            found = max(found, float(np.median(own_apart - apart)))
    return found
