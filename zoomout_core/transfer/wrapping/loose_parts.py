# SPDX-License-Identifier: GPL-3.0-or-later
"""Loose parts, such as eyes and teeth, follow their surroundings by similarities."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.procrustes import Moments, Similarities, procrustes
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.transfer.inpaint import are_small
from zoomout_core.transfer.wrapping.fit import Fit

# Number of vertices of larger parts near each vertex of a loose part that determine its motion.
NEIGHBOURS = 8
# Minimum share of a part's area with trusted images for placing the part by them.
MIN_TRUSTED_SHARE = 0.5


def moves_as_a_whole(working: WorkingMesh, weight: Floats) -> Booleans:
    """(n,) vertices of parts that are small, or without any weight (n,)."""
    return np.asarray((are_small(working) | (np.bincount(working.component, weight) == 0))[working.component])


def with_loose_parts(fit: Fit, positions: Floats) -> Floats:
    """(n, 3) positions in which loose parts follow their surroundings, at unit area of the source.

    A part rotates with its surroundings, because images do not determine the rotation of a ball. Trusted images
    determine its place and size.
    """
    working, rest = fit.working, fit.working.vertices
    loose = moves_as_a_whole(working, fit.weight)
    whole = np.flatnonzero(~loose)
    if not len(whole) or not loose.any():
        return positions
    positions, tree = positions.copy(), cKDTree(rest[whole])
    order = np.flatnonzero(loose)
    order = order[np.argsort(working.component[order], kind="stable")]
    for part in np.split(order, np.flatnonzero(np.diff(working.component[order])) + 1):
        near = tree.query(rest[part], min(NEIGHBOURS, len(whole)))[1]
        near = whole[np.unique(near)]
        motion = procrustes(rest[near], positions[near], handedness=fit.rest_mesh.handedness[part[0]])
        trust, areas = fit.trust[part] * fit.rest_mesh.areas[part], fit.rest_mesh.areas[part]
        if trust.sum() >= MIN_TRUSTED_SHARE * areas.sum():
            motion = _place(
                motion, Moments.between(rest[part], fit.projections.images[part], trust), fit.projections.images[part]
            )
        positions[part] = motion(rest[part])
    return positions


def _place(motion: Similarities, own: Moments, images: Floats) -> Similarities:
    """A motion with the same rotation that moves a part to the centre of its images, and scales it to their size."""
    spread = np.einsum("nx,nx->", images - own.image, images - own.image) / len(images)
    scale = np.sqrt(spread / np.maximum(own.spread, 1e-300))
    return Similarities(scale, motion.rotation, own.image - scale * motion.rotation @ own.place)
