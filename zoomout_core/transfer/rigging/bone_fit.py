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
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST, Moments, Similarities, nearest_rotations, procrustes
from zoomout_core.mesh.affine_maps import normalise, transform_points
from zoomout_core.mesh.errors import MeshError
from zoomout_core.transfer.rigging.skinning import matrices_of, row_of, skinning_matrices
from zoomout_core.tuning import Tuning, tuned

# Shared weight of bones and parents without a common vertex: less than that of any bones with one.
MIN_SHARED = 1e-15
# Added to the diagonal of linear systems, relative to its mean, for bones without any constraint.
DAMPING = 1e-9


@dataclass(frozen=True)
class BoneTuning(Tuning, set_by="binding"):
    """The fit of bone transforms; lengths are relative to the root mean square distance of points from their mean.

    Attributes:
        coherence: weight of a bone's agreement with the bone that it shares most vertices with; bones with less area or
            trust follow that neighbour.
        of_others: the same if the points are of another body, whose proportions would else bend and shift bones. With
            1, game animals at rest end a fifth closer to their own rest shape, but people in strong poses half again as
            far from it.
        radius: distance at which a difference of two rotations is converted to a distance of points.
        rounds: number of rounds of robust weights.
        steps: Gauss-Newton steps of a round.
        slides: Gauss-Newton steps of a fit along normals.
        outlying: residual, relative to the median, at which the weight of a vertex is halved.
        precision: minimum of this residual.
        sliding: weight of residuals along the surface, where images may slide, relative to those along normals.
        same_size: a common scale closer to one than this is set to one.
        same_pose: largest mean angle between the bones' rotations and one common rotation in the rest pose.
    """

    coherence: float = tuned(1e-5, "of the area", 0, 1)
    of_others: float = tuned(0.3, "of the area", 0, 100)
    radius: float = tuned(0.05, "1", 1e-6, 10)
    rounds: int = tuned(4, "rounds", 1, 100)
    steps: int = tuned(4, "steps", 1, 100)
    slides: int = tuned(2, "steps", 1, 100)
    outlying: float = tuned(3.0, "1", 0.1, 1000)
    precision: float = tuned(0.005, "1", 1e-9, 1)
    sliding: float = tuned(0.005, "1", 0, 1)
    same_size: float = tuned(0.02, "1", 0, 1)
    same_pose: float = tuned(5.0, "degrees", 0, 180)


BONES = BoneTuning()


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
    fit = _Fit(points, images, weights, trust, parents, coherence)
    tree = _tree(fit)
    transforms = _fit_one_by_one(fit, tree)
    for _ in range(BONES.rounds):
        for _ in range(BONES.steps):
            transforms = _step(fit, tree, transforms)
        off = transform_points(skinning_matrices(transforms, fit.shares), fit.points) - fit.images
        fit.measure(fit.fitting(np.linalg.norm(off, axis=1)))
        transforms = replace(transforms, scale=np.full(len(transforms.scale), fit.of_bones()[1]))
    for _ in range(BONES.steps):
        transforms = _step(fit, tree, transforms)
    return fit.pose(transforms)


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
    fit = _Fit(points, images, weights, trust, parents)
    tree, transforms = _tree(fit), fit.inside(start.transforms[fit.moving])
    off = transform_points(skinning_matrices(transforms, fit.shares), fit.points) - fit.images
    fit.measure(fit.fitting(abs(np.einsum("nx,nx->n", off, normals))))
    for _ in range(BONES.slides):
        transforms = _step(fit, tree, transforms, normals)
    return fit.pose(transforms)


class _Fit:
    """The least squares problem of images y of points x by bones of weights w: sum of c |y - sum of w T x|^2.

    With x~ = (x, 1) and transforms T (3, 4), it consists of moments: S for pairs of bones, the sums of c w w' x~ x~^T,
    and C for single bones, the sums of c w y x~^T. Points and images are centred, in units of the points' extent.
    Images are also divided by the common scale, so that the regularisation does not depend on it. Only bones that move
    something are included.
    """

    def __init__(
        self,
        points: Floats,
        images: Floats,
        weights: csr_array,
        trust: Floats,
        parents: ArrayLike | None,
        coherence: float | None = None,
    ) -> None:
        self.coherence = BONES.coherence if coherence is None else coherence
        shares = normalise(weights)
        trust = np.where(np.diff(shares.indptr) > 0, trust, 0)
        mass = shares.T @ trust
        if not mass.sum() > 0:
            raise MeshError(
                "No vertex with a reliable match has bone weights: check the match, or the source's vertex groups."
            )
        self.moving = np.flatnonzero(mass > 0)
        self.mass = mass[self.moving] / mass.sum()
        self.trust = trust / trust.sum()
        self.shares = csr_array(shares[:, self.moving])
        self.middle, self.image = self.trust @ points, self.trust @ images
        self.size = np.sqrt(max(self.trust @ ((points - self.middle) ** 2).sum(axis=1), SMALLEST))
        self.image_size = self.size
        self.points, self.images = (points - self.middle) / self.size, (images - self.image) / self.size
        self.all_parents = np.full(len(mass), -1) if parents is None else np.asarray(parents, dtype=np.int64)
        self.measure(np.ones(len(points)))
        scale = self.of_bones()[1]
        if scale != 1:
            self.image_size = self.size * scale
            self.images = self.images / scale
            self.measure(np.ones(len(points)))

    def measure(self, fitting: Floats) -> None:
        """Compute the moments of points with weights of fit (n,)."""
        self.counts, count = self.trust * fitting, self.shares.shape[1]
        extended = np.column_stack([self.points, np.ones(len(self.points))])
        vertex = row_of(self.shares)
        self.pairs = np.empty((count, count, 4, 4))
        for i in range(4):
            weighted = csr_array(
                (self.shares.data * (self.counts * extended[:, i])[vertex], self.shares.indices, self.shares.indptr),
                shape=self.shares.shape,
            )
            sums = (weighted.T @ _widen(self.shares, extended[vertex, : i + 1])).toarray()
            self.pairs[:, :, i, : i + 1] = self.pairs[:, :, : i + 1, i] = sums.reshape(count, count, i + 1)
        mixed = (self.counts[:, None, None] * self.images[:, :, None] * extended[:, None]).reshape(-1, 12)
        self.singles = np.asarray(self.shares.T @ mixed).reshape(count, 3, 4)

    def fitting(self, off: Floats) -> Floats:
        """(n,) robust weights of points with residuals (n,) (Cauchy's weights)."""
        order = np.argsort(off)
        below = np.cumsum(self.trust[order])
        median = off[order[np.searchsorted(below, below[-1] / 2)]]
        return np.asarray(1 / (1 + (off / max(BONES.outlying * median, BONES.precision)) ** 2))

    def of_bones(self) -> tuple[Moments, float]:
        """Moments of the vertices of each bone, weighted by the squares of their weights, and the common scale.

        The common scale follows from the spread of points, which does not depend on rotations (Horn 1987).
        """
        squared = self.shares.copy()
        squared.data **= 2
        counted = csr_array(squared.T @ diags_array(self.counts))
        mass = np.maximum(counted.sum(axis=1), SMALLEST)[:, None]
        place, image = counted @ self.points / mass, counted @ self.images / mass
        mixed = (self.images[:, :, None] * self.points[:, None]).reshape(-1, 9)
        cross = (counted @ mixed / mass).reshape(-1, 3, 3) - image[:, :, None] * place[:, None]
        own, other = (
            (counted @ (each**2) / mass - mean**2).sum(axis=1)
            for each, mean in ((self.points, place), (self.images, image))
        )
        spreads = mass[:, 0] @ own, mass[:, 0] @ other
        scale = float(np.sqrt(spreads[1] / spreads[0])) if min(spreads) > 0 else 1.0
        same = self.size / self.image_size  # the scale at which the given points and images are of one size
        return Moments(place, image, cross, own), same if abs(scale / same - 1) < BONES.same_size else scale

    def inside(self, transforms: Similarities) -> Similarities:
        """Convert transforms of the given points and images to those of the problem."""
        place = np.einsum("bxy,y->bx", transforms.linear, self.middle)
        shift = (transforms.translation + place - self.image) / self.image_size
        return Similarities(transforms.scale * (self.size / self.image_size), transforms.rotation, shift)

    def _outside(self, transforms: Similarities) -> Similarities:
        """Convert transforms of the problem to those of the given points and images."""
        scale = transforms.scale / (self.size / self.image_size)
        place = np.einsum("b,bxy,y->bx", scale, transforms.rotation, self.middle)
        return Similarities(scale, transforms.rotation, self.image + self.image_size * transforms.translation - place)

    def pose(self, transforms: Similarities) -> Pose:
        """Make a pose from transforms of the problem."""
        found = self._outside(transforms)
        scale = float(transforms.scale[0])
        own = procrustes(self.points, self.images, self.trust, scales=(scale, scale))
        fallback = self._outside(Similarities(own.scale[None], own.rotation[None], own.translation[None]))
        common = Similarities(fallback.scale[0], fallback.rotation[0], fallback.translation[0])
        above = next_above(self.all_parents, self.moving)
        everyone = Similarities.concatenate([found, fallback])[above]  # -1 is the last one
        return Pose(everyone, common, _bend(transforms.rotation, self.mass))


@dataclass(frozen=True, eq=False)
class _Tree:
    """The spanning tree of the bones."""

    order: Integers  # (b,) bones outwards from the one that moves most, one tree after the other
    above: Integers  # (b,) the preceding bone of each in the tree, -1 for the first of a tree
    joint: Floats  # (b, 3) the point where each meets that bone


def _tree(fit: _Fit) -> _Tree:
    """The spanning tree of the bones that share most vertices, or of bones and parents if they share none."""
    shared = fit.pairs[:, :, 3, 3].copy()
    np.fill_diagonal(shared, 0)
    parents = next_above(fit.all_parents, fit.moving, strictly=True)[fit.moving]
    child = np.flatnonzero(parents >= 0)
    hanging = shared.copy()
    hanging[child, parents[child]] += MIN_SHARED
    hanging = np.maximum(hanging, hanging.T)
    costs = np.divide(1, hanging, out=np.zeros_like(hanging), where=hanging > 0)
    edges = minimum_spanning_tree(csr_array(costs))
    order, above = list[int](), np.full(len(fit.mass), -1)
    for root in np.argsort(-fit.mass, kind="stable").tolist():
        if root not in order:
            found, before = breadth_first_order(edges, root, directed=False)
            order += found.tolist()
            above[found[1:]] = before[found[1:]]
    bone = np.arange(len(above))
    together = np.where((shared[bone, above] > 0) & (above >= 0), above, bone)  # else the centroid of its vertices
    moments = fit.pairs[bone, together]
    joint = moments[:, :3, 3] / np.maximum(moments[:, 3, 3], SMALLEST)[:, None]
    return _Tree(np.array(order), above, joint)


def next_above(parents: Integers, moving: Integers, strictly: bool = False) -> Integers:
    """(b,) the nearest of the moving bones from each bone upwards, numbered among these; -1 for none.

    With `strictly` the search begins at the bone's parent (b,), which is -1 for none.
    """
    number = np.full(len(parents) + 1, -1)
    number[moving] = np.arange(len(moving))
    above = parents.copy() if strictly else np.arange(len(parents))
    for _ in range(len(parents)):  # no chain is longer
        skipped = (above >= 0) & (number[above] < 0)
        if not skipped.any():
            break
        above[skipped] = parents[above[skipped]]
    return number[above]


def _fit_one_by_one(fit: _Fit, tree: _Tree) -> Similarities:
    """Procrustes fits of the bones, outwards from the one that moves most, each regularised by its predecessor."""
    moments, scale = fit.of_bones()
    rotation = np.empty((len(fit.mass), 3, 3))
    leaning = scale * fit.coherence * BONES.radius**2
    for bone in tree.order:
        near = tree.above[bone]
        lean = leaning * rotation[near] if near >= 0 else np.zeros((3, 3))
        rotation[bone] = nearest_rotations(fit.mass[bone] * moments.cross[bone] + lean)
    translation = moments.image - scale * np.einsum("bxy,by->bx", rotation, moments.place)
    return Similarities(np.full(len(rotation), scale), rotation, translation)


def _step(fit: _Fit, tree: _Tree, now: Similarities, normals: Floats | None = None) -> Similarities:
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
    _lean(fit, tree, now, matrices, directions, system, load)
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


def _along_normals(fit: _Fit, now: Similarities, centre: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """The system (b, 6, b, 6) and load (b, 6) of distances along normals."""
    shares, count = fit.shares, len(centre)
    row, bone = row_of(shares), shares.indices
    arm = transform_points(matrices_of(now)[bone], fit.points[row]) - centre[bone]
    normal = normals[row]
    jacobian = _widen(shares, np.concatenate([np.cross(arm, normal), normal], axis=1))
    off = fit.images - transform_points(skinning_matrices(now, shares), fit.points)
    counted = csr_array(jacobian.T @ diags_array(fit.counts))
    load = counted @ np.einsum("nx,nx->n", off, normals)
    return (counted @ jacobian).toarray().reshape(count, 6, count, 6), load.reshape(count, 6)


def _widen(shares: csr_array, factors: Floats) -> csr_array:
    """(n, w b) weights (n, b) whose entries are multiplied by w factors (entries, w) each, side by side."""
    width = factors.shape[1]
    columns = width * shares.indices[:, None].astype(np.int64) + np.arange(width)
    return csr_array(
        ((shares.data[:, None] * factors).ravel(), columns.ravel(), width * shares.indptr.astype(np.int64)),
        shape=(shares.shape[0], width * shares.shape[1]),
    )


def _lean(
    fit: _Fit, tree: _Tree, now: Similarities, matrices: Floats, directions: Floats, system: Floats, load: Floats
) -> None:
    """Add terms to a linear system that make connected bones meet at their joint and rotate alike."""
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


def _bend(rotations: Floats, mass: Floats) -> float:
    """Mean angle in degrees between rotations (b, 3, 3) and their mean, weighted by mass (b,)."""
    mean = nearest_rotations(np.einsum("b,bxy->xy", mass, rotations))
    return float(np.degrees(mass @ Rotation.from_matrix(rotations @ mean.T).magnitude()))
