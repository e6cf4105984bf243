# SPDX-License-Identifier: GPL-3.0-or-later
"""Procrustes analysis: the rotations and similarities that best align point sets, by least squares.

The singular value decomposition of the covariance determines the rotation: Kabsch, A solution for the best rotation to
relate two sets of vectors (1976). It also determines scale and translation: Umeyama, Least-squares estimation of
transformation parameters between two point patterns (1991). Everything is batched: `...` means any leading dimensions,
none for a single pair of point sets.

A handedness is 1 for rotations, -1 for reflections, and None for the better fit of the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats, Integers

# Guard against division by zero.
SMALLEST = 1e-300
# Rounding error of variances that are computed as differences of means, for places at unit area.
MIN_SPREAD = 1e-12
# Fewer matrices are decomposed: their rotations in closed form would take longer.
MANY_MATRICES = 64
# Laguerre's method reaches double precision in this many steps for matrices of unit norm, if the product (a + b) (b +
# c) (c + a) of their singular values is above the second number. Others are ambiguous, and decomposed.
LAGUERRE_STEPS, MIN_CLEARNESS = 6, 0.003


def nearest_rotations(matrices: Floats, handedness: ArrayLike | None = 1.0) -> Floats:
    """(..., d, d) rotations, or reflections, nearest to matrices (..., d, d).

    The orthogonal part of the polar decomposition (Higham 1986), with the direction of the smallest singular value
    reversed if the handedness (...) requires it.
    """
    if handedness is not None and matrices.shape[-2:] == (3, 3) and matrices.size >= 9 * MANY_MATRICES:
        sense = np.where(np.less(handedness, 0), -1.0, 1.0)[..., None, None]
        return np.asarray(sense * _rotations_in_space((sense * matrices).reshape(-1, 3, 3)).reshape(matrices.shape))
    return _by_decomposition(matrices, handedness)


def _by_decomposition(matrices: Floats, handedness: ArrayLike | None = 1.0) -> Floats:
    """`nearest_rotations` by the singular value decomposition, even of matrices with several nearest rotations."""
    U, _, Vt = np.linalg.svd(matrices)
    if handedness is not None:
        U[..., -1] *= (np.where(np.less(handedness, 0), -1.0, 1.0) * np.sign(np.linalg.det(U @ Vt)))[..., None]
    return np.asarray(U @ Vt)


def _rotations_in_space(matrices: Floats) -> Floats:
    """(n, 3, 3) rotations nearest to many matrices, in a fifth of the time of singular value decompositions.

    With singular values a, b, c, the last one negative if the determinant is, s = a + b + c is the largest root of
    (s^2 - |M|^2)^2 - 8 det(M) s - 4 |cof(M)|^2 (Horn, Closed-form solution of absolute orientation using unit
    quaternions, 1987). By the Cayley-Hamilton theorem, the rotation is a polynomial of M and its cofactors, divided by
    (a + b) (b + c) (c + a).
    """
    size = np.maximum(np.sqrt(np.einsum("nij,nij->n", matrices, matrices)), SMALLEST)
    rows = np.ascontiguousarray(np.moveaxis(matrices / size[:, None, None], 0, -1))  # of unit norm
    a, b, c = rows
    cofactors = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)])
    det, minors = np.einsum("in,in->n", a, cofactors[0]), np.einsum("ijn,ijn->n", cofactors, cofactors)
    total = np.full(len(matrices), np.sqrt(3))
    for _ in range(LAGUERRE_STEPS):
        beyond = total**2 - 1
        value, slope = beyond**2 - 8 * det * total - 4 * minors, 4 * total * beyond - 8 * det
        discriminant = 9 * slope**2 - 48 * value * (3 * total**2 - 1)
        total -= 4 * value / np.maximum(slope + np.sqrt(np.maximum(discriminant, 0)), SMALLEST)
    clearness = total * (total**2 - 1) / 2 - det
    ambiguous = ~(clearness > MIN_CLEARNESS)
    cubes = np.einsum("ijn,jkn->ikn", rows, np.einsum("ijn,ikn->jkn", rows, rows))
    turned = ((total**2 + 1) / 2 * rows + total * cofactors - cubes) / np.where(ambiguous, 1, clearness)
    rotations = np.ascontiguousarray(np.moveaxis(turned, -1, 0))
    if ambiguous.any():
        rotations[ambiguous] = _by_decomposition(matrices[ambiguous])
    return rotations


def _cross(x: Floats, y: Floats) -> Floats:
    """(3, n) cross products of vectors given by their coordinates (3, n)."""
    return np.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])


def procrustes(
    points: Floats,
    images: Floats,
    weights: Floats | None = None,
    handedness: ArrayLike | None = 1.0,
    scales: tuple[ArrayLike, ArrayLike] = (0.0, np.inf),
) -> Similarities:
    """The similarities that bring point sets (..., n, d) closest to their images (..., n, d).

    Weights (n,) or (..., n) are not negative and not all zero. The handedness (...) is 1 for rotations, -1 for
    reflections, None for the better fit. The scales (...) are the minimum and maximum; (1, 1) for rigid motions.
    """
    return Moments.between(points, images, weights).similarities(handedness, scales)


@dataclass(frozen=True, eq=False)
class Similarities:
    """x -> scale * rotation x + translation, one or many.

    Attributes:
        scale: (...).
        rotation: (..., d, d) orthogonal.
        translation: (..., d).
    """

    scale: Floats
    rotation: Floats
    translation: Floats

    @property
    def linear(self) -> Floats:
        """(..., d, d) product of scale and rotation."""
        return np.asarray(self.scale[..., None, None] * self.rotation)

    def __call__(self, points: Floats) -> Floats:
        """Transform points (..., n, d)."""
        turned = points @ np.swapaxes(self.rotation, -1, -2)
        return np.asarray(self.scale[..., None, None] * turned + self.translation[..., None, :])

    def inverse(self, points: Floats) -> Floats:
        """Transform points (..., n, d) back."""
        return np.asarray((points - self.translation[..., None, :]) @ self.rotation / self.scale[..., None, None])

    def __getitem__(self, chosen: int | slice | Integers) -> Similarities:
        return Similarities(self.scale[chosen], self.rotation[chosen], self.translation[chosen])

    def repeat(self, count: int) -> Similarities:
        """The same similarity several times."""
        return Similarities(*(np.stack([each] * count) for each in (self.scale, self.rotation, self.translation)))

    @classmethod
    def concatenate(cls, several: Sequence[Similarities]) -> Similarities:
        """Join several along their first dimension."""
        names = "scale", "rotation", "translation"
        return cls(*(np.concatenate([getattr(each, name) for each in several]) for name in names))


@dataclass(frozen=True, eq=False)
class Moments:
    """First and second moments of places x and their images y, which determine the best alignment.

    Attributes:
        place: (..., d) mean x.
        image: (..., d) mean y.
        cross: (..., d, d) covariance of y and x.
        spread: (...) variance of x, summed over the coordinates.
    """

    place: Floats
    image: Floats
    cross: Floats
    spread: Floats

    @classmethod
    def between(cls, points: Floats, images: Floats, weights: Floats | None = None) -> Moments:
        """The moments of point sets and their images (..., n, d) with weights (..., n), see `procrustes`."""
        share = np.ones(points.shape[-2]) if weights is None else weights
        share = (share / share.sum(axis=-1, keepdims=True))[..., None, :]
        place, image = share @ points, share @ images
        offset = points - place
        weighted = np.swapaxes(offset, -1, -2) * share
        spread = np.einsum("...dn,...nd->...", weighted, offset)
        return cls(place[..., 0, :], image[..., 0, :], np.swapaxes(weighted @ (images - image), -1, -2), spread)

    @classmethod
    def of_products(cls, means: Floats) -> Moments:
        """The moments of patches, from the patches' means (m, 16) of `products`."""
        place, image = means[:, :3], means[:, 3:6]
        cross = means[:, 6:15].reshape(-1, 3, 3) - image[:, :, None] * place[:, None]
        return cls(place, image, cross, np.maximum(means[:, 15] - (place**2).sum(axis=1), MIN_SPREAD))

    @cached_property
    def _decomposition(self) -> tuple[Floats, Floats, Floats]:
        """The singular value decomposition of the covariances."""
        return np.linalg.svd(self.cross)

    @cached_property
    def _parity(self) -> Floats:
        """(...) 1 where the factors of the decomposition give rotations, -1 where they give reflections."""
        U, _, Vt = self._decomposition
        return np.asarray(np.sign(np.linalg.det(U @ Vt)))

    def _signs(self, handedness: ArrayLike | None) -> Floats:
        """(..., d) signs of the singular values for matrices of a handedness."""
        signs = np.ones(self.place.shape)
        if handedness is not None:
            signs[..., -1] = np.sign(handedness) * self._parity
        return signs

    @cached_property
    def handedness(self) -> float:
        """1 if rotations fit all patches together better than reflections, else -1.

        Both fit a flat patch equally well, so all patches are considered together.
        """
        return -1.0 if (self._parity * self._decomposition[1][..., -1]).sum() < 0 else 1.0

    def rotations(self, handedness: ArrayLike | None = 1.0) -> Floats:
        """(..., d, d) best rotations, or reflections."""
        U, _, Vt = self._decomposition
        return np.asarray((U * self._signs(handedness)[..., None, :]) @ Vt)

    def scale(self, handedness: ArrayLike | None = 1.0) -> Floats:
        """(...) best scales."""
        total = (self._decomposition[1] * self._signs(handedness)).sum(axis=-1)
        return np.asarray(total / np.maximum(self.spread, SMALLEST))

    def similarities(
        self, handedness: ArrayLike | None = 1.0, scales: tuple[ArrayLike, ArrayLike] = (0.0, np.inf)
    ) -> Similarities:
        """The best similarities with scales (...) within bounds; see `procrustes`."""
        scale, rotation = np.clip(self.scale(handedness), *scales), self.rotations(handedness)
        translation = self.image - scale[..., None] * np.einsum("...ij,...j->...i", rotation, self.place)
        return Similarities(scale, rotation, translation)


def products(places: Floats, images: Floats) -> Floats:
    """(n, 16) places, images, products of both, and squares: see `Moments.of_products`."""
    mixed = (images[:, :, None] * places[:, None]).reshape(-1, 9)
    return np.hstack([places, images, mixed, (places**2).sum(axis=1, keepdims=True)])


def fit_neighbourhoods(means: Floats, handedness: Floats) -> tuple[Floats, Floats]:
    """Fit a similarity to each of m neighbourhoods.

    Args:
        means: (m, 18) means over each neighbourhood of `products`, of the squared lengths of images, and of ones.
        handedness: (m,) 1 for rotations, -1 for reflections; or (1,) for all.

    Returns:
        (m, 3, 3) linear parts, and (m,) root mean square residuals, as shares of the neighbourhood's size.
    """
    means = means[:, :17] / means[:, 17:]
    moments = Moments.of_products(means[:, :16])
    found = moments.similarities(handedness)
    spread = np.maximum(means[:, 16] - (moments.image**2).sum(axis=1), MIN_SPREAD)
    missed = np.maximum(spread - found.scale**2 * moments.spread, 0)
    return found.linear, np.sqrt(missed / spread)
