# SPDX-License-Identifier: GPL-3.0-or-later
"""Factors of sparse symmetric matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csc_array, diags_array

from zoomout_core.geometry.sparse_solve import factorise


def second_differences(n: int) -> csc_array:
    """(n, n) stiffness of a chain, plus a small mass."""
    return csc_array(diags_array([-np.ones(n - 1), np.full(n, 2.01), -np.ones(n - 1)], offsets=[-1, 0, 1]))


def test_multiple_right_hand_sides_are_solved() -> None:
    matrix = second_differences(200)
    solutions = np.random.default_rng(0).normal(size=(200, 7))
    factors = factorise(matrix)
    np.testing.assert_allclose(factors.solve(matrix @ solutions), solutions, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(factors.solve(matrix @ solutions[:, 0]), solutions[:, 0], rtol=1e-9, atol=1e-9)


def test_factors_pivot_on_the_diagonal_and_give_the_inertia() -> None:
    # Some off-diagonal entries exceed the diagonal, so partial pivoting would choose them.
    matrix = csc_array(np.array([[1.0, 3.0, 0.0], [3.0, 10.0, 2.0], [0.0, 2.0, -5.0]]))
    factors = factorise(matrix)
    np.testing.assert_array_equal(factors.perm_r, factors.perm_c)
    assert (factors.U.diagonal() < 0).sum() == (np.linalg.eigvalsh(matrix.toarray()) < 0).sum()


def test_singular_matrices_are_refused() -> None:
    with pytest.raises(RuntimeError, match="singular"):
        factorise(csc_array(np.ones((2, 2))))
