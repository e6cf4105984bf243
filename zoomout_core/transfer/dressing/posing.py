# SPDX-License-Identifier: GPL-3.0-or-later
"""Take a dressed body to the pose of its target before the fit: from an A-pose to a T-pose, for example.

Joints turn, and keep their distances from each other, so that clothes are bent as in an animation. The fit to the
other build comes after.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST, procrustes
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.transfer.dressing.joints import move_joints
from zoomout_core.transfer.stretch import parents_first

# A joint turns only if the direction to a joint below it differs by more than this, in degrees: between builds in the
# same pose these differ by 19 at most, and A-poses from T-poses by 30 to 45.
SAME_POSE = 22.0
# It does not turn if the next joint would have to turn by this much more: an arm turns at the shoulder, not at the
# collarbone.
LATER = 1.1
# The joint below is the first on the chain at this distance, as a share of the body's extent: nearer ones give noise.
REACH = 0.1


def pose_like(
    body: Surface, shape: ArrayLike, weights: csr_array, parents: ArrayLike, heads: ArrayLike
) -> Floats | None:
    """Transforms of a body's joints that take it to the pose of another shape; None if it is in that pose already.

    Args:
        body: the body.
        shape: (n, 3) its vertices in the other shape.
        weights: (n, b) sparse skin weights.
        parents: (b,) the number of each joint's parent, -1 for none.
        heads: (b, 3) the places that the joints turn about.

    Returns:
        (b, 3, 4) transforms, without a change of size.
    """
    above, places = np.asarray(parents, dtype=np.int64), np.asarray(heads, dtype=np.float64)
    after = np.asarray(shape, dtype=np.float64)
    # Directions are compared in the frame of the body as a whole.
    images = procrustes(body.vertices, after).inverse(move_joints(body, after, places).positions)
    reach = REACH * float(np.ptp(body.vertices, axis=0).max())
    following = _next_joints(above, np.asarray(weights.T @ body.vertex_areas))
    below = _joints_below(following, places, reach)

    def swing(joint: int, rotation: Floats) -> Rotation:
        """How a joint, or none, turns a rotated body towards the other pose."""
        other = below[joint] if joint >= 0 else -1
        if other < 0:
            return Rotation.identity()
        return _swing(rotation @ (places[other] - places[joint]), images[other] - images[joint])

    turned = False
    transforms = np.zeros((len(above), 3, 4))
    for joint in parents_first(above):
        parent = transforms[above[joint]] if above[joint] >= 0 else np.eye(3, 4)
        rotation = parent[:, :3]
        own, later = (swing(each, rotation) for each in (joint, following[joint]))
        if own.magnitude() > np.radians(SAME_POSE) and later.magnitude() < LATER * own.magnitude():
            rotation, turned = own.as_matrix() @ rotation, True
        place = parent[:, :3] @ places[joint] + parent[:, 3]
        transforms[joint] = np.column_stack([rotation, place - rotation @ places[joint]])
    return transforms if turned else None


def _next_joints(parents: Integers, areas: Floats) -> Integers:
    """(b,) the joint below each one that moves the largest area, with those below it; -1 at the end of a chain."""
    total, following = areas.copy(), np.full(len(parents), -1)
    for joint in reversed(parents_first(parents)):
        parent = parents[joint]
        if parent >= 0 and total[joint] > 0:
            total[parent] += total[joint]
            if following[parent] < 0 or total[joint] > total[following[parent]]:
                following[parent] = joint
    return following


def _joints_below(following: Integers, heads: Floats, reach: float) -> Integers:
    """(b,) the first joint on the chain below each one that is at least so far away; -1 where the chain ends before."""
    found = np.full(len(following), -1)
    for joint, other in enumerate(following):
        while other >= 0 and np.linalg.norm(heads[other] - heads[joint]) < reach:
            other = following[other]
        found[joint] = other
    return found


def _swing(direction: Floats, other: Floats) -> Rotation:
    """The smallest rotation of one direction to another one."""
    one, two = unit_vectors(np.array([direction, other]))
    axis = np.cross(one, two)
    angle = np.arctan2(np.linalg.norm(axis), one @ two)
    return Rotation.from_rotvec(angle * axis / max(np.linalg.norm(axis), SMALLEST))
