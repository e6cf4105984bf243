# SPDX-License-Identifier: GPL-3.0-or-later
"""Axes of bones, which tell another build from another pose.

Bones rotate to fit a wider or shorter body, but their axes keep their directions. The axis of a bone is from its joint,
the mean of the vertices that it moves together with another bone, to the mean of all its vertices. Both are means of
whole cross-sections, whose width does not matter.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.mesh.affine_maps import normalise

# Maximum angle of an axis from its direction in the rest pose, in degrees: more is a bend of the limb.
MAX_SWING = 12.0
# Maximum angle between the swings of bones that meet, in degrees. Otherwise, half of a bend in the middle of a body
# would count on either side, and pass.
MAX_BEND = 16.0
# Maximum part of the area on bones beyond these angles: a hand or a lower arm is larger.
MAX_SWUNG = 0.005


def keep_axes(rotation: Floats, points: Floats, images: Floats, weights: csr_array, trust: Floats) -> bool:
    """Whether bones keep the directions of their axes, apart from a common rotation.

    Args:
        rotation: (3, 3) that of all bones together.
        points: (n, 3) places in the rest pose.
        images: (n, 3) the same places on the other body.
        weights: (n, b) sparse skin weights.
        trust: (n,) weights of the places, such as their areas.

    Returns:
        Whether all but `MAX_SWUNG` of the area is on such bones. A bone that shares no vertex has no axis.
    """
    shares = normalise(weights)
    before, shared = _means(points @ rotation.T, shares, trust)
    after, _ = _means(images, shares, trust)
    arms = [means[np.arange(len(means)), np.arange(len(means))][:, None] - means for means in (before, after)]
    joint = np.argmax(shared * np.linalg.norm(arms[0], axis=2), axis=1)  # (b,) the bone that shares most, and is far
    bone = np.arange(len(joint))
    first, second = (each[bone, joint] for each in arms)  # (b, 3) axes
    product = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    swings = np.cross(first, second) / np.maximum(product, SMALLEST)[:, None]
    keeps = np.einsum("bx,bx->b", first, second) >= np.cos(np.radians(MAX_SWING)) * product
    keeps &= np.linalg.norm(swings - swings[joint], axis=1) <= np.sin(np.radians(MAX_BEND))
    keeps &= shared[bone, joint] * product > 0
    mass = shares.T @ trust
    return bool(mass @ ~keeps <= MAX_SWUNG * mass.sum())


def _means(points: Floats, shares: csr_array, trust: Floats) -> tuple[Floats, Floats]:
    """(b, b, 3) means of points (n, 3) that two bones move together, and (b, b) the weight of each."""
    columns = np.column_stack([points, np.ones(len(points))]) * trust[:, None]
    sums = np.stack([(shares.T @ diags_array(each) @ shares).toarray() for each in columns.T], axis=2)
    return sums[:, :, :3] / np.maximum(sums[:, :, 3:], SMALLEST), sums[:, :, 3]
