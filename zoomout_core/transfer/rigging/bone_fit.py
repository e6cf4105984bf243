# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit the bone transforms that take a surface from the rest pose to a pose, given its skin weights.

A least squares problem, as in the smooth skinning decomposition of Le and Deng (2012). Each bone is first fitted by
weighted Procrustes analysis, then Gauss-Newton steps fit all bones together. A step only needs the moments of pairs of
bones. Images that may slide along a surface are fitted along its normals (point to plane: Chen and Medioni 1992), with
the steps for articulated bodies of Pekelny and Gotsman (2008).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import SMALLEST, Similarities, nearest_rotations, procrustes
from zoomout_core.mesh.affine_maps import transform_points
from zoomout_core.transfer.rigging.bone_problem import BONES, BoneProblem, widen
from zoomout_core.transfer.rigging.bone_tree import BoneTree, bone_tree, next_above
from zoomout_core.transfer.rigging.skinning import matrices_of, row_of, skinning_matrices

# Added to the diagonal of linear systems, relative to its mean, for bones without any constraint.
DAMPING = 1e-9


@dataclass(frozen=True, eq=False)
class Pose:
    """The transforms of bones that pose a surface."""

    transforms: Similarities  # (b,) from rest to the pose, of one scale; bones without weights follow an ancestor
    common: Similarities  # the best single similarity, of the same scale
    bend: float  # mean angle between their rotations and their mean, in degrees, weighted by the area that bones move
    same_axes: bool = False  # whether the bones have the directions of the rest pose, so that rotations are of a build

    @property
    def scale(self) -> float:
        """The common scale of the bones."""
        return float(self.common.scale)

    @property
    def is_rest(self) -> bool:
        """Whether this is the rest pose, up to a similarity."""
        return self.same_axes or self.bend <= BONES.same_pose


def estimate_pose(
    points: Floats,
    images: Floats,
    weights: csr_array,
    trust: Floats,
    parents: ArrayLike | None = None,
    coherence: float | None = None,
) -> Pose:
    """Estimate the pose that takes points to their images: rigid motions of the bones, after a common scale.

    Args:
        points: (n, 3) positions in the rest pose.
        images: (n, 3) positions in the pose.
        weights: (n, b) sparse skin weights, not negative.
        trust: (n,) weight of each point, not negative: its area times the trust in its image.
        parents: (b,) the number of each bone's parent, -1 for none; by default no bone has one.
        coherence: weight of the agreement of connected bones; by default that of `BoneTuning`.

    Raises:
        MeshError: no trusted point has a weight.
    """
    fit = BoneProblem(points, images, weights, trust, parents, coherence)
    tree = bone_tree(fit)
    transforms = _fit_one_by_one(fit, tree)
    for _ in range(BONES.rounds):
        for _ in range(BONES.steps):
            transforms = _step(fit, tree, transforms)
        off = transform_points(skinning_matrices(transforms, fit.shares), fit.points) - fit.images
        fit.compute_moments(fit.robust_weights(np.linalg.norm(off, axis=1)))
        transforms = replace(transforms, scale=np.full(len(transforms.scale), fit.bone_moments()[1]))
    for _ in range(BONES.steps):
        transforms = _step(fit, tree, transforms)
    return _pose(fit, transforms)


def refine_pose(
    start: Pose,
    points: Floats,
    images: Floats,
    normals: Floats,
    weights: csr_array,
    trust: Floats,
    parents: ArrayLike | None = None,
) -> Pose:
    """Refine a pose along normals, so that images may slide along a surface; the scale stays.

    The normals (n, 3) are unit normals of that surface at the images; other arguments are as for `estimate_pose`.
    """
    fit = BoneProblem(points, images, weights, trust, parents)
    tree, transforms = bone_tree(fit), fit.to_problem(start.transforms[fit.moving])
    off = transform_points(skinning_matrices(transforms, fit.shares), fit.points) - fit.images
    fit.compute_moments(fit.robust_weights(abs(np.einsum("nx,nx->n", off, normals))))
    for _ in range(BONES.slides):
        transforms = _step(fit, tree, transforms, normals)
    return _pose(fit, transforms)


def _fit_one_by_one(fit: BoneProblem, tree: BoneTree) -> Similarities:
    """Procrustes fits of the bones, outwards from the one that moves most, each regularised by its predecessor."""
    moments, scale = fit.bone_moments()
    rotation = np.empty((len(fit.mass), 3, 3))
    leaning = scale * fit.coherence * BONES.radius**2
    for bone in tree.order:
        near = tree.above[bone]
        lean = leaning * rotation[near] if near >= 0 else np.zeros((3, 3))
        rotation[bone] = nearest_rotations(fit.mass[bone] * moments.cross[bone] + lean)
    translation = moments.image - scale * np.einsum("bxy,by->bx", rotation, moments.place)
    return Similarities(np.full(len(rotation), scale), rotation, translation)


def _step(fit: BoneProblem, tree: BoneTree, now: Similarities, normals: Floats | None = None) -> Similarities:
    """One Gauss-Newton step, which rotates bones about the centroids of their vertices, and translates them."""
    count = len(now.scale)
    own = fit.pairs[np.arange(count), np.arange(count)]
    middle = own[:, :3, 3] / np.maximum(own[:, 3, 3], SMALLEST)[:, None]
    matrices = matrices_of(now)
    centre = transform_points(matrices, middle)
    directions = _directions(matrices, centre)
    system = _between_bones(directions, fit.pairs)
    residual = fit.singles - np.tensordot(matrices, fit.pairs, ((0, 2), (0, 2))).swapaxes(0, 1)
    load = np.einsum("baix,bix->ba", directions, residual)
    if normals is not None:
        along, pull = _along_normals(fit, now, centre, normals)
        system, load = BONES.sliding * system + along, BONES.sliding * load + pull
    _add_coherence(fit, tree, now, matrices, directions, system, load)
    system = system.reshape(6 * count, 6 * count)
    system += DAMPING * np.trace(system) / len(system) * np.eye(len(system))
    change = np.linalg.solve(system, load.ravel()).reshape(count, 2, 3)
    turn = Rotation.from_rotvec(change[:, 0]).as_matrix()
    translation = np.einsum("bxy,by->bx", turn, now.translation - centre) + centre + change[:, 1]
    return Similarities(now.scale, turn @ now.rotation, translation)


def _between_bones(directions: Floats, pairs: Floats) -> Floats:
    """(b, 6, b, 6) products of derivatives (b, 6, 3, 4) of two bones, by moments of pairs of bones (b, b, 4, 4).

    Most pairs have no common vertex, and are left out.
    """
    bone, other = np.nonzero(pairs[:, :, 3, 3])
    half = directions[bone].reshape(-1, 18, 4) @ pairs[bone, other]
    system = np.zeros((len(pairs), 6, len(pairs), 6))
    system[bone, :, other] = half.reshape(-1, 6, 12) @ directions[other].reshape(-1, 6, 12).swapaxes(1, 2)
    return system


def _directions(matrices: Floats, centre: Floats) -> Floats:
    """(b, 6, 3, 4) derivatives of transforms by rotations about centres (b, 3), and by translations."""
    directions = np.zeros((len(matrices), 6, 3, 4))
    about = matrices.copy()
    about[:, :, 3] -= centre
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        directions[:, axis, i], directions[:, axis, j] = -about[:, j], about[:, i]
        directions[:, 3 + axis, axis, 3] = 1
    return directions


def _along_normals(fit: BoneProblem, now: Similarities, centre: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """The system (b, 6, b, 6) and load (b, 6) of distances along normals."""
    shares, count = fit.shares, len(centre)
    row, bone = row_of(shares), shares.indices
    arm = transform_points(matrices_of(now)[bone], fit.points[row]) - centre[bone]
    normal = normals[row]
    jacobian = widen(shares, np.concatenate([np.cross(arm, normal), normal], axis=1))
    off = fit.images - transform_points(skinning_matrices(now, shares), fit.points)
    counted = csr_array(jacobian.T @ diags_array(fit.counts))
    load = counted @ np.einsum("nx,nx->n", off, normals)
    return (counted @ jacobian).toarray().reshape(count, 6, count, 6), load.reshape(count, 6)


def _add_coherence(
    fit: BoneProblem,
    tree: BoneTree,
    now: Similarities,
    matrices: Floats,
    directions: Floats,
    system: Floats,
    load: Floats,
) -> None:
    """Add terms to a linear system (in place) that make connected bones meet at their joint and rotate alike."""
    bone = np.flatnonzero(tree.above >= 0)
    near = tree.above[bone]
    joint = np.column_stack([tree.joint[bone], np.ones(len(bone))])
    # Derivatives of the distance at the joint, and of the difference of rotations, by each of both bones.
    changes = np.zeros((len(bone), 2, 6, 6))
    for side, (sign, which) in enumerate(((1, bone), (-1, near))):
        changes[:, side, :, :3] = sign * np.einsum("eaix,ex->eai", directions[which], joint)
        changes[:, side, :3, 3:] = sign * BONES.radius * np.eye(3)
    apart = np.einsum("eix,ex->ei", matrices[near] - matrices[bone], joint)
    turn = Rotation.from_matrix(now.rotation[near] @ np.swapaxes(now.rotation[bone], 1, 2)).as_rotvec()
    wanted = np.concatenate([apart, BONES.radius * turn], axis=1)
    for side, which in enumerate((bone, near)):
        np.add.at(load, which, fit.coherence * np.einsum("eai,ei->ea", changes[:, side], wanted))
        for other, what in enumerate((bone, near)):
            blocks = fit.coherence * np.einsum("eai,eci->eac", changes[:, side], changes[:, other])
            np.add.at(system.transpose(0, 2, 1, 3), (which, what), blocks)


def _pose(fit: BoneProblem, transforms: Similarities) -> Pose:
    """The pose of transforms (b,) of the problem, which lacks the bones that move nothing."""
    own = fit.from_problem(transforms)
    scale = float(transforms.scale[0])
    whole = procrustes(fit.points, fit.images, fit.trust, scales=(scale, scale))
    fallback = fit.from_problem(Similarities(whole.scale[None], whole.rotation[None], whole.translation[None]))
    common = Similarities(fallback.scale[0], fallback.rotation[0], fallback.translation[0])
    above = next_above(fit.all_parents, fit.moving)
    all_bones = Similarities.concatenate([own, fallback])[above]  # -1 is the fallback
    return Pose(all_bones, common, _bend(transforms.rotation, fit.mass))


def _bend(rotations: Floats, mass: Floats) -> float:
    """Mean angle in degrees between rotations (b, 3, 3) and their mean, weighted by mass (b,)."""
    mean = nearest_rotations(np.einsum("b,bxy->xy", mass, rotations))
    return float(np.degrees(mass @ Rotation.from_matrix(rotations @ mean.T).magnitude()))
