"""How a body moves to its image, and whatever lies around it moves along.

Around every vertex of the body the similarity is known that fits its surroundings best (Umeyama, Least-squares
estimation of transformation parameters between two point patterns, 1991). Blended, they move any point, and
bend what is long (Sumner, Schmid and Pauly, Embedded deformation for shape manipulation, 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class SimilarityFieldTuning(Tuning, set_by="judgement"):
    """Over what the similarities around a body are fitted and blended.

    Attributes:
        widths: diffusion lengths over which surroundings are pooled: the farther off a point, the wider.
        neighbours: vertices of the body whose similarities are blended for a point.
        most_scale: factor by which a body grows or shrinks locally, at most, against its typical scale: maps squeeze
            by mistake.
    """

    widths: tuple[float, ...] = tuned((0.04, 0.1, 0.25), "at unit area", 1e-6, 10)
    neighbours: int = tuned(12, "vertices", 1, 1000)
    most_scale: float = tuned(2.0, "1", 1, 100)


SIMILARITIES = SimilarityFieldTuning()


@dataclass(frozen=True, eq=False)
class Moments:
    """Means and products of places x and their images y over patches, which say how each patch moves.

    Attributes:
        place: (m, 3) mean x.
        image: (m, 3) mean y.
        cross: (m, 3, 3) covariance of y and x.
        spread: (m,) variance of x.
    """

    place: Floats
    image: Floats
    cross: Floats
    spread: Floats

    @classmethod
    def of(cls, products: Floats) -> Moments:
        """From the patches' means (m, 16) of what `products` gives."""
        place, image = products[:, :3], products[:, 3:6]
        cross = products[:, 6:15].reshape(-1, 3, 3) - image[:, :, None] * place[:, None]
        return cls(place, image, cross, np.maximum(products[:, 15] - (place**2).sum(axis=1), 1e-12))

    @cached_property
    def singular(self) -> tuple[Floats, Floats, Floats]:
        """The singular value decomposition of the covariances."""
        return np.linalg.svd(self.cross)

    @cached_property
    def handedness(self) -> float:
        """1 where the patches turn, -1 where they are mirrored: which of the two leaves less over.

        A flat patch does both equally well; all of them together are not flat, unless nothing is.
        """
        U, singular, Vt = self.singular
        return -1.0 if (np.linalg.det(U @ Vt) * singular[:, 2]).sum() < 0 else 1.0

    def scale(self, handedness: float) -> Floats:
        """(m,) by how much the patches grow."""
        return np.asarray((self.singular[1] * self._signs(handedness)).sum(axis=1) / self.spread)

    def _signs(self, handedness: float) -> Floats:
        """(m, 3) of the singular values, for patches that turn, or are mirrored."""
        U, singular, Vt = self.singular
        signs = np.ones_like(singular)
        signs[:, 2] = np.linalg.det(U @ Vt) * handedness
        return signs

    def affine(self, handedness: float) -> Floats:
        """(m, 12) the similarities of the patches: linear part, row by row, and shift."""
        U, _, Vt = self.singular
        signs = self._signs(handedness)
        scale = self.scale(handedness)
        typical = np.median(scale)
        scale = np.clip(scale, typical / SIMILARITIES.most_scale, typical * SIMILARITIES.most_scale)
        linear = scale[:, None, None] * ((U * signs[:, None]) @ Vt)
        shift = self.image - np.einsum("mij,mj->mi", linear, self.place)
        return np.hstack([linear.reshape(-1, 9), shift])


def products(places: Floats, images: Floats) -> Floats:
    """(n, 16) places, images, products of both, and squares: their means over a patch say how it moves."""
    mixed = (images[:, :, None] * places[:, None]).reshape(-1, 9)
    return np.hstack([places, images, mixed, (places**2).sum(axis=1, keepdims=True)])


@dataclass(frozen=True, eq=False)
class SimilarityField:
    """The motion of a body to its image.

    Attributes:
        places: (n, 3) vertices of the body's mesh, in a frame in which its area is one.
        images: (n, 3) where they go.
        trust: (n,) how far that is to be trusted.
        basis: of the body's mesh.
    """

    places: Floats
    images: Floats
    trust: Floats
    basis: SpectralBasis

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.places)

    @cached_property
    def handedness(self) -> float:
        """-1 where the body goes to its mirror image, else 1."""
        return self._moments[0].handedness

    @cached_property
    def scale(self) -> float:
        """By how much it grows in most places."""
        moments = self._moments[-1]
        return float(np.median(moments.scale(self.handedness)))

    @cached_property
    def _moments(self) -> list[Moments]:
        """Those of the surroundings of each vertex, for each of the widths."""
        local = products(self.places, self.images)
        return [Moments.of(self.basis.smoothed(local, width**2)) for width in SIMILARITIES.widths]

    def carry(self, points: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
        """Where the body takes points around it.

        Args:
            points: (q, 3) in the frame of the places.
            normals: (q, 3) directions to be turned along.

        Returns:
            (q, 3) points, (q, 3) unit directions, and (q,) trust in the body there.
        """
        count = min(SIMILARITIES.neighbours, len(self.places))
        distance, near = (np.reshape(part, (len(points), count)) for part in self._tree.query(points, count))
        weights = (1 - distance / (distance[:, -1:] * (1 + 1e-3) + 1e-300)) ** 2
        weights /= weights.sum(axis=1, keepdims=True)
        start = np.arange(0, near.size + 1, count)
        blend = csr_array((weights.ravel(), near.ravel(), start), shape=(len(points), len(self.places)))
        widths = np.log(SIMILARITIES.widths)
        level = np.interp(np.log(np.maximum(distance[:, 0], 1e-300)), widths, np.arange(len(widths)))
        affine = np.zeros((len(points), 12))
        for i, moments in enumerate(self._moments):
            share = np.maximum(1 - np.abs(level - i), 0)
            rows = np.flatnonzero(share)
            if len(rows):
                affine[rows] += share[rows, None] * (blend[rows] @ moments.affine(self.handedness))
        return *moved(affine, points, normals), blend @ self.trust


def moved(affine: Floats, points: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Points (q, 3) and directions (q, 3), each moved by an affine map of its own (q, 12)."""
    linear = affine[:, :9].reshape(-1, 3, 3)
    turned = np.einsum("qij,qj->qi", linear, normals)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    unit = np.divide(turned, length, out=np.zeros_like(turned), where=length > 0)
    return np.einsum("qij,qj->qi", linear, points) + affine[:, 9:], unit
