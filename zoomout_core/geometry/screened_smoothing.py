# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth values over a mesh, with weights that keep them close to the input: screened Poisson equations.

Bhat, Curless, Cohen and Zitnick, Fourier analysis of the 2D screened Poisson equation for gradient domain problems
(2008), on meshes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU

from zoomout_core.arrays import Floats
from zoomout_core.geometry.sparse_solve import factorise


@dataclass(frozen=True, eq=False)
class ScreenedSmoothing:
    """The system (W + h^2 L) x = W v + h^2 g of weights W, a length h and a stiffness L, factored once.

    Its solution x is close to the values v where weights are large compared to h^2 L. Elsewhere its gradients have the
    divergence g, zero for plain smoothing. With the vertices' areas as weights, h is the averaging length.

    Attributes:
        weights: (n,) the diagonal of W, positive.
        length: h, in the unit of the mesh.
        factors: factors of the (n, n) matrix.
    """

    weights: Floats
    length: float
    factors: SuperLU

    @classmethod
    def of(cls, weights: Floats, stiffness: csc_array, length: float) -> ScreenedSmoothing:
        """Factor the system for weights (n,), a stiffness (n, n) and a length."""
        return cls(weights, length, factorise(screened_stiffness(weights, stiffness, length)))

    def smooth(self, values: Floats) -> Floats:
        """(n, d) solutions for values (n, d) and no gradients: weighted means over about the length."""
        return self.solve(self.weights[:, None] * values)

    def fit(self, values: Floats, divergence: Floats) -> Floats:
        """(n, d) solutions for values (n, d) and the divergence (n, d) of gradients, see `turn_gradients`."""
        return self.solve(self.loads(values, divergence))

    def loads(self, values: Floats, divergence: Floats) -> Floats:
        """(n, d) the right-hand side W v + h^2 g of values (n, d) and a divergence (n, d)."""
        return np.asarray(self.weights[:, None] * values + self.length**2 * divergence)

    def solve(self, loads: Floats) -> Floats:
        """(n, d) solutions for right-hand sides (n, d)."""
        # SuperLU needs contiguous columns.
        return np.asarray(self.factors.solve(np.asfortranarray(loads)))


def screened_stiffness(weights: Floats, stiffness: csc_array, length: float) -> csc_array:
    """(n, n) the matrix W + h^2 L of `ScreenedSmoothing`."""
    return csc_array(diags_array(weights) + length**2 * stiffness)
