"""Rotations that lie nearest to matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats


def nearest_rotations(matrices: Floats, handed: ArrayLike = 1.0) -> Floats:
    """(..., 3, 3) the rotations nearest to matrices (..., 3, 3); where `handed` (...) is negative, the reflections.

    The orthogonal part of the polar decomposition (Higham 1986), with the sign of the least direction as it has to be.
    """
    U, _, Vt = np.linalg.svd(matrices)
    U[..., 2] *= (np.sign(handed) * np.sign(np.linalg.det(U @ Vt)))[..., None]
    return np.asarray(U @ Vt)
