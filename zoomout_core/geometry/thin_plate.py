# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth deformations of space: thin-plate splines in three dimensions.

The spline f(x) = A x + b + sum_j w_j |x - c_j| minimises a bending energy among all functions with the same values at
the centres (Duchon, Splines minimizing rotation-invariant semi-norms in Sobolev spaces, 1977; Bookstein, Principal
warps, 1989). As in Wahba (Spline models for observational data, 1990) it is fitted to noisy data with fewer centres
than data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from zoomout_core.arrays import Floats
from zoomout_core.mesh.triangles import cross, unit_vectors

# Guards the solution where data do not determine it, relative to the mean of the diagonal.
RIDGE = 1e-10
# Smallest distance from a centre, where the spline has no derivative.
SMALLEST = 1e-9


class ThinPlateBasis:
    """The functions that thin-plate splines with some centres consist of.

    Args:
        centres: (j, 3) positions, at least four, not all in one plane.

    Attributes:
        bending: (k, k) the quadratic form of the bending energy; there are as many functions as centres.
    """

    def __init__(self, centres: Floats) -> None:
        self.centres = centres
        affine = np.hstack([np.ones((len(centres), 1)), centres])
        # Weights of finite bending energy are orthogonal to affine functions at the centres.
        self._weights = np.linalg.qr(affine, mode="complete")[0][:, 4:]
        self.bending = np.zeros((len(centres), len(centres)))
        self.bending[4:, 4:] = -self._weights.T @ self._distances(centres) @ self._weights

    def at(self, points: Floats) -> Floats:
        """(q, k) values of the functions at points (q, 3): the constant, the coordinates, then the distances."""
        return np.hstack([np.ones((len(points), 1)), points, self._distances(points) @ self._weights])

    def inverse_distances(self, points: Floats) -> Floats:
        """(q, j) inverse distances of points (q, 3) from the centres, which the derivatives there consist of."""
        return np.asarray(1 / np.maximum(self._distances(points), SMALLEST))

    def jacobians(self, points: Floats, coefficients: Floats, inverse: Floats) -> Floats:
        """(q, 3, 3) derivatives at points (q, 3) of a deformation with coefficients (k, 3), by row of its values.

        Args:
            points: where.
            coefficients: of the deformation.
            inverse: (q, j) the `inverse_distances` of the points.
        """
        # The gradient of |x - c| is (x - c) / |x - c|; both terms are sums over centres, without an array (q, j, 3).
        weights = self._weights @ coefficients[4:]
        at_centres = (weights[:, :, None] * self.centres[:, None]).reshape(-1, 9)
        bent = (inverse @ weights)[:, :, None] * points[:, None] - (inverse @ at_centres).reshape(-1, 3, 3)
        return np.asarray(coefficients[1:4].T + bent)

    def _distances(self, points: Floats) -> Floats:
        squares = (points**2).sum(axis=1)[:, None] + (self.centres**2).sum(axis=1) - 2 * points @ self.centres.T
        return np.sqrt(np.maximum(squares, 0))


@dataclass(frozen=True, eq=False)
class ThinPlateFit:
    """A deformation fitted to data.

    Attributes:
        basis: its functions.
        coefficients: (k, 3) their coefficients.
    """

    basis: ThinPlateBasis
    coefficients: Floats

    @classmethod
    def of(cls, basis: ThinPlateBasis, rows: Floats, goals: Floats, weights: Floats, stiffness: float) -> ThinPlateFit:
        """The deformation that minimises the weighted squared distances from goals, plus the bending energy.

        Args:
            basis: its functions.
            rows: (n, k) their values at the data's places.
            goals: (n, 3) where these should go.
            weights: (n, 3, 3) the squared distance of an offset d is d^T W d; or (n,) if all directions count alike.
            stiffness: factor of the bending energy.
        """
        k = rows.shape[1]
        if weights.ndim == 1:  # the coordinates do not depend on each other
            normal = rows.T @ (weights[:, None] * rows) + stiffness * basis.bending
            return cls(basis, _solve(normal, rows.T @ (weights[:, None] * goals)))
        normal = np.zeros((k, 3, k, 3))
        for i in range(3):
            for j in range(i, 3):
                normal[:, i, :, j] = normal[:, j, :, i] = rows.T @ (weights[:, i, j, None] * rows)
            normal[:, i, :, i] += stiffness * basis.bending
        pulls = rows.T @ np.einsum("nij,nj->ni", weights, goals)
        return cls(basis, _solve(normal.reshape(3 * k, 3 * k), pulls.reshape(-1, 1)).reshape(k, 3))

    @property
    def bending_energy(self) -> float:
        """Its bending energy: zero for affine maps."""
        return float(np.einsum("ki,kl,li->", self.coefficients, self.basis.bending, self.coefficients))

    def deform(self, points: Floats) -> Floats:
        """(q, 3) images of points (q, 3)."""
        return np.asarray(self.basis.at(points) @ self.coefficients)

    def turn(self, points: Floats, normals: Floats, inverse: Floats | None = None) -> Floats:
        """(q, 3) unit normals of the deformed surface, for the unit normals (q, 3) at points (q, 3) of a surface.

        Args:
            points: on the surface.
            normals: of the surface there.
            inverse: (q, j) the basis's `inverse_distances` of the points, if known from an earlier deformation.
        """
        inverse = self.basis.inverse_distances(points) if inverse is None else inverse
        rows = self.basis.jacobians(points, self.coefficients, inverse)
        # The cofactor matrix turns normals; its sign keeps the outside outside under a reflection, too.
        cofactors = np.stack([cross(rows[:, (i + 1) % 3], rows[:, (i + 2) % 3]) for i in range(3)], axis=1)
        handed = np.sign(np.linalg.det(rows))
        return unit_vectors(handed[:, None] * np.einsum("qyx,qx->qy", cofactors, normals))


def _solve(normal: Floats, right: Floats) -> Floats:
    """(n, d) the solution of a normal equation with matrix (n, n), which is overwritten, and right sides (n, d)."""
    normal[np.diag_indices(len(normal))] += RIDGE * np.trace(normal) / len(normal)
    factor = cho_factor(normal, overwrite_a=True, check_finite=False)
    return np.asarray(cho_solve(factor, right, check_finite=False))
