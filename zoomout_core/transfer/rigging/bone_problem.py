# SPDX-License-Identifier: GPL-3.0-or-later
"""The least squares problem of the transforms of bones that pose a surface: its data, moments and robust weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import SMALLEST, Moments, Similarities
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.errors import MeshError
from zoomout_core.transfer.rigging.skinning import row_of
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class BoneTuning(Tuning, set_by="binding"):
    """The fit of bone transforms; lengths are relative to the root mean square distance of points from their mean.

    Attributes:
        coherence: weight of a bone's agreement with the bone that it shares most vertices with; bones with less area or
            trust follow that neighbour.
        of_others: the same if the points are of another body, whose proportions would otherwise bend bones. With
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


class BoneProblem:
    """The least squares problem of images y of points x by bones of weights w: sum of c |y - sum of w T x|^2.

    With x~ = (x, 1) and transforms T (3, 4), it consists of moments: S for pairs of bones, the sums of c w w' x~ x~^T,
    and C for single bones, the sums of c w y x~^T. Points and images are centred, in units of the points' extent.
    Images are also divided by the common scale, so that the regularisation does not depend on it. Only bones that move
    something are included.

    Attributes:
        points: (n, 3) positions at rest.
        images: (n, 3) positions in the pose.
        trust: (n,) weight of each point; the sum is one.
        counts: (n,) the same times its robust weight.
        shares: (n, b) skin weights; the sum of each row is one or zero.
        moving: (b,) numbers of the bones among all.
        mass: (b,) share of the trusted points that each bone moves.
        all_parents: the parent of each of all bones, -1 for none.
        coherence: weight of the agreement of connected bones.
        pairs: (b, b, 4, 4) the moments S.
        singles: (b, 3, 4) the moments C.
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
        self.compute_moments(np.ones(len(points)))
        scale = self.bone_moments()[1]
        if scale != 1:
            self.image_size = self.size * scale
            self.images = self.images / scale
            self.compute_moments(np.ones(len(points)))

    def compute_moments(self, robust_weights: Floats) -> None:
        """Compute the moments of points with robust weights (n,)."""
        self.counts, count = self.trust * robust_weights, self.shares.shape[1]
        extended = np.column_stack([self.points, np.ones(len(self.points))])
        vertex = row_of(self.shares)
        self.pairs = np.empty((count, count, 4, 4))
        for i in range(4):
            weighted = csr_array(
                (self.shares.data * (self.counts * extended[:, i])[vertex], self.shares.indices, self.shares.indptr),
                shape=self.shares.shape,
            )
            sums = (weighted.T @ widen(self.shares, extended[vertex, : i + 1])).toarray()
            self.pairs[:, :, i, : i + 1] = self.pairs[:, :, : i + 1, i] = sums.reshape(count, count, i + 1)
        mixed = (self.counts[:, None, None] * self.images[:, :, None] * extended[:, None]).reshape(-1, 12)
        self.singles = np.asarray(self.shares.T @ mixed).reshape(count, 3, 4)

    def robust_weights(self, residuals: Floats) -> Floats:
        """(n,) Cauchy's robust weights of points with residuals (n,)."""
        order = np.argsort(residuals)
        below = np.cumsum(self.trust[order])
        median = residuals[order[np.searchsorted(below, below[-1] / 2)]]
        return np.asarray(1 / (1 + (residuals / max(BONES.outlying * median, BONES.precision)) ** 2))

    def bone_moments(self) -> tuple[Moments, float]:
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

    def to_problem(self, transforms: Similarities) -> Similarities:
        """Convert transforms of the given points and images to those of the problem."""
        place = np.einsum("bxy,y->bx", transforms.linear, self.middle)
        shift = (transforms.translation + place - self.image) / self.image_size
        return Similarities(transforms.scale * (self.size / self.image_size), transforms.rotation, shift)

    def from_problem(self, transforms: Similarities) -> Similarities:
        """Convert transforms of the problem to those of the given points and images."""
        scale = transforms.scale / (self.size / self.image_size)
        place = np.einsum("b,bxy,y->bx", scale, transforms.rotation, self.middle)
        return Similarities(scale, transforms.rotation, self.image + self.image_size * transforms.translation - place)


def widen(shares: csr_array, factors: Floats) -> csr_array:
    """(n, w b) weights (n, b) whose entries are multiplied by w factors (entries, w) each, side by side."""
    width = factors.shape[1]
    columns = width * shares.indices[:, None].astype(np.int64) + np.arange(width)
    return csr_array(
        ((shares.data[:, None] * factors).ravel(), columns.ravel(), width * shares.indptr.astype(np.int64)),
        shape=(shares.shape[0], width * shares.shape[1]),
    )
