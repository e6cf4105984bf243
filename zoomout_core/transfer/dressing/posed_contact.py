# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact in poses: displace cloth at rest so that it stays outside the skin below it when bones rotate.

Cloth and skin have different weights, so narrow gaps close in poses. Only places that stay near the skin below them are
displaced. Where limbs touch, or where cloth hangs freely, no displacement at rest would help.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.surface_map import interpolation_matrix
from zoomout_core.mesh.affine_maps import blend_matrices
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.transfer.dressing.barriers import CONTACT, SidedSurface
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PosedContactTuning(Tuning, set_by="outfits"):
    """Which places are kept outside the skin in poses, and how smoothly.

    Attributes:
        near: maximum distance from the skin at rest, and maximum change of this distance in a pose.
        depth: maximum depth below the margin in a pose.
        spread: length over which a push is spread. Poses push in patches, whose borders would be visible at rest.
    """

    near: float = tuned(0.02, "at unit area", 0, 1)
    depth: float = tuned(0.004, "at unit area", 0, 1)
    spread: float = tuned(0.045, "at unit area", 1e-6, 1)


POSED_CONTACT = PosedContactTuning()
# Minimum squared length of a normal that is transformed back to rest: a blend of opposite rotations hardly moves a
# place.
MIN_LENGTH = 0.25


class PosedBody(NamedTuple):
    """The motion of a body by its bones.

    Attributes:
        weights: (n, b) its weights, whose rows sum to one.
        poses: (f, b, 3, 4) transforms of the bones from rest.
    """

    weights: csr_array
    poses: Floats


class PosedBounds:
    """Places that must stay above the same places of the skin as at rest, in each pose.

    Args:
        places: (p, 3) the places at rest.
        weights: (p, b) their weights.
        skin: the body at rest.
        body: how bones move it, in the unit of the places.
    """

    def __init__(self, places: Floats, weights: csr_array, skin: SidedSurface, body: PosedBody) -> None:
        beside = skin.beside(places, POSED_CONTACT.near)
        triangle, barycentric, distance = skin.closest(places[beside])
        near = np.flatnonzero(distance < POSED_CONTACT.near)
        which, below = (
            beside[near],
            interpolation_matrix(skin.triangles[triangle[near]], barycentric[near], len(skin.vertices)),
        )
        off = np.einsum("px,px->p", places[which] - below @ skin.vertices, unit_vectors(below @ skin.normals))
        # Beside a border of the skin, the side is not known.
        above = off >= CONTACT.facing * distance[near]
        follows = np.flatnonzero(above & (off > 0))
        self._which, below = which[follows], below[follows]
        self._margin = np.minimum(off[follows], CONTACT.min_margin)
        self._poses = list[_Pose]()
        for transforms in body.poses:
            matrices = blend_matrices(transforms, body.weights)
            posed = np.einsum("nxy,ny->nx", matrices[:, :, :3], skin.vertices) + matrices[:, :, 3]
            normals = unit_vectors(below @ vertex_normals(posed, skin.triangles))
            every, moved = np.arange(len(self._which)), blend_matrices(transforms, weights[self._which])
            pose = _Pose(every, moved, below @ posed, normals)
            # Other places are far outside, or deep inside where limbs touch.
            missing, offset = self._missing(pose, places)
            near = np.einsum("px,px->p", offset, offset) < (POSED_CONTACT.near + POSED_CONTACT.depth) ** 2
            chosen = np.flatnonzero((np.abs(missing) < POSED_CONTACT.depth) & near)
            self._poses.append(_Pose(chosen, moved[chosen], pose.feet[chosen], normals[chosen]))

    def pushes(self, places: Floats) -> tuple[Integers, Floats]:
        """(v,) numbers of the places (p, 3) that are too close in a pose, and (v, 3) how they must move at rest."""
        worst, pushes = np.full(len(self._which), CONTACT.settled), np.zeros((len(self._which), 3))
        for pose in self._poses:
            missing, _ = self._missing(pose, places)
            closer = np.flatnonzero(missing > worst[pose.rows])
            towards = np.einsum("pxy,px->py", pose.matrices[closer, :, :3], pose.normals[closer])
            length = np.maximum(np.einsum("px,px->p", towards, towards), MIN_LENGTH)
            pushes[pose.rows[closer]] = (missing[closer] / length)[:, None] * towards
            worst[pose.rows[closer]] = missing[closer]
        pushed = np.flatnonzero(worst > CONTACT.settled)
        return self._which[pushed], pushes[pushed]

    def _missing(self, pose: _Pose, places: Floats) -> tuple[Floats, Floats]:
        """(c,) the depths of the rows of a pose below their margins, and (c, 3) their offsets from the skin."""
        at = places[self._which[pose.rows]]
        offset = np.einsum("pxy,py->px", pose.matrices[:, :, :3], at) + pose.matrices[:, :, 3] - pose.feet
        return self._margin[pose.rows] - np.einsum("px,px->p", offset, pose.normals), offset


class _Pose(NamedTuple):
    """A pose of places, and of the skin below them."""

    rows: Integers  # (c,) numbers of the places
    matrices: Floats  # (c, 3, 4) from rest to the pose
    feet: Floats  # (c, 3) the places of the skin
    normals: Floats  # (c, 3) its normals there
