# SPDX-License-Identifier: GPL-3.0-or-later
"""Joints of a rig that are nearly symmetric, made exactly symmetric."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.geometry.procrustes import SMALLEST, Similarities, nearest_rotations, procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class SymmetricJointsTuning(Tuning, set_by="rigs"):
    """When a rig or a surface counts as symmetric.

    Attributes:
        max_distance: largest distance of a joint from the mirror image of its partner, and of the surface from its own
            mirror image. Relative to the root mean square distance of joints from their mean.
    """

    max_distance: float = tuned(0.03, "1", 0, 1)


SYMMETRIC_JOINTS = SymmetricJointsTuning()

# Rounds of assigning joints to mirror images, which converge after two or three.
ROUNDS = 5
# A rig is symmetric if at least this share of its joints is: others may belong to a weapon in one hand.
MIN_PAIRED = 0.8
# A surface is symmetric if at least this share of its vertices is: others may belong to hair or to a pocket.
SYMMETRIC_SHARE = 0.99
# Largest number of vertices by which the symmetry of a surface is measured.
MAX_MIRRORED = 2000


def make_symmetric(
    before: Floats, found: Floats, rotations: Floats, edges: Integers, target: Surface
) -> tuple[Floats, Floats]:
    """Positions (j, 3) and rotations (j, 3, 3) of joints, made symmetric if those before are nearly symmetric.

    The joints that were found, or the target's surface, must nearly be as well. The surface is the target's own: a map
    with errors on one side would make the source in the target's shape asymmetric.
    """
    joint, partner = _mirror_pairs(before, edges)
    if not len(joint):
        return found, rotations
    earlier, mirror = (_mirror(points[joint], points[partner]) for points in (before, found))
    off = _distances(mirror(found[joint]), found[partner], found)
    if (off > SYMMETRIC_JOINTS.max_distance).any():
        mirror, off = _mirror_of_surface(target, mirror)
        if np.quantile(_relative_to(off, found), SYMMETRIC_SHARE) > SYMMETRIC_JOINTS.max_distance:
            return found, rotations
    positions, turned = found.copy(), rotations.copy()
    positions[joint] = (found[joint] + mirror(found[partner])) / 2
    turned[joint] = nearest_rotations(rotations[joint] + mirror.rotation @ rotations[partner] @ earlier.rotation.T)
    return positions, turned


def _mirror_pairs(joints: Floats, edges: Integers) -> tuple[Integers, Integers]:
    """Joints that a plane of symmetry mirrors, and the mirror image of each, which may be itself; none without one."""
    bones = set(map(tuple, edges.tolist()))
    middle, everyone = joints.mean(axis=0), np.arange(len(joints))
    for normal in np.linalg.svd(joints - middle, full_matrices=True)[2]:
        image = joints - 2 * np.outer((joints - middle) @ normal, normal)
        for _ in range(ROUNDS):
            partner = np.asarray(cKDTree(joints).query(image)[1])
            paired = (partner[partner] == everyone) & (
                _distances(image, joints[partner], joints) <= SYMMETRIC_JOINTS.max_distance
            )
            if np.mean(paired) < MIN_PAIRED:
                break
            image = _mirror(joints[paired], joints[partner[paired]])(joints)
        else:
            inside = edges[paired[edges].all(axis=1)]
            if (partner != everyone)[paired].any() and bones.issuperset(map(tuple, partner[inside].tolist())):
                return everyone[paired], partner[paired]
    return everyone[:0], everyone[:0]


def _mirror(points: Floats, images: Floats) -> Similarities:
    """The reflection that brings points (j, 3) closest to their images (j, 3)."""
    return procrustes(points, images, handedness=-1, scales=(1, 1))


def _mirror_of_surface(surface: Surface, start: Similarities) -> tuple[Similarities, Floats]:
    """The reflection near another one that brings a surface closest to itself, and distances of vertices from it."""
    chosen = np.linspace(0, len(surface.vertices) - 1, min(len(surface.vertices), MAX_MIRRORED)).astype(np.int64)
    points, mirror = surface.vertices[chosen], start
    search = SurfaceSearch(surface.vertices, surface.triangles)
    for _ in range(ROUNDS):
        image = SurfaceMap(*search.closest(mirror(points)), surface.triangles).interpolate(surface.vertices)
        mirror = _mirror(points, image)
    return mirror, np.linalg.norm(mirror(points) - image, axis=1)


def _distances(points: Floats, others: Floats, joints: Floats) -> Floats:
    """(m,) distances of points from others, relative to the extent of joints."""
    return _relative_to(np.linalg.norm(points - others, axis=1), joints)


def _relative_to(distances: Floats, joints: Floats) -> Floats:
    """(m,) distances, relative to the root mean square distance of joints (j, 3) from their mean."""
    extent = np.sqrt(((joints - joints.mean(axis=0)) ** 2).sum(axis=1).mean())
    return np.asarray(distances / max(extent, SMALLEST))
