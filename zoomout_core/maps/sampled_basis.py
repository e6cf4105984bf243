# SPDX-License-Identifier: GPL-3.0-or-later
"""An eigenbasis at samples of its surface, where ZoomOut iterates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from zoomout_core.arrays import Floats, Integers
from zoomout_core.spectral.eigenbasis import SpectralBasis

# A column of a triangular factor with a smaller diagonal entry, relative to the largest, depends on earlier columns.
DEPENDENT = 1e-12


@dataclass(frozen=True, eq=False)
class SampledBasis:
    """A basis at samples, factorised once so that least squares with any k are a triangular solve.

    Attributes:
        samples: (s,) vertex numbers.
        rows: (s, k) eigenvectors at the samples.
        Q: (s, k) orthonormal; its leading columns, with an upper triangular R, factorise the leading columns of `rows`.
        R_inverse: (k, k) upper triangular; the inverse of a leading block of R is the same block of this.
    """

    samples: Integers
    rows: Floats
    Q: Floats
    R_inverse: Floats

    @classmethod
    def of(cls, basis: SpectralBasis, samples: Integers) -> SampledBasis:
        """The basis at the samples (s,): the leading eigenfunctions that are linearly independent there."""
        rows = basis.eigenvectors[samples]
        Q, R = qr(rows, mode="economic")
        diagonal = np.abs(R.diagonal())
        k = int(np.argmin([*(diagonal > DEPENDENT * diagonal.max(initial=0)), False]))
        return cls(samples, rows[:, :k], Q[:, :k], solve_triangular(R[:k, :k], np.eye(k)))

    def fit(self, values: Floats, k: int) -> Floats:
        """(..., k, d) least-squares coefficients of values (..., s, d) at the samples."""
        return np.asarray(self.R_inverse[:k, :k] @ (self.Q[:, :k].T @ values))
