# SPDX-License-Identifier: GPL-3.0-or-later
"""Gradients of values at vertices: rotated ones, and products of two."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_array, csc_array, diags_array

from zoomout_core.arrays import Floats


def without_sums(stiffness: csc_array) -> csc_array:
    """A stiffness matrix with the same edges, whose columns sum to zero."""
    return csc_array(stiffness - diags_array(stiffness.sum(axis=0)))


def turn_gradients(stiffness: csc_array, turns: Floats) -> bsr_array:
    """(3n, 3n) divergence of rotated gradients: a symmetric stiffness (n, n) applied to values with these gradients.

    For each vertex i the sum of w_ij (M_i + M_j) / 2 (v_i - v_j) over its neighbours, with the weights w_ij of edges
    and the matrices M (n, 3, 3); for values (n, 3) as one column. Rows of the stiffness sum to zero.
    """
    n = len(turns)
    row, column = np.repeat(np.arange(n), np.diff(stiffness.indptr)), stiffness.indices
    blocks = stiffness.data[:, None, None] * (turns[row] + turns[column]) / 2
    sums = (stiffness @ turns.reshape(n, 9)).reshape(n, 3, 3) / 2
    blocks[row == column] -= sums[row[row == column]]
    return bsr_array((blocks, column, stiffness.indptr), shape=(3 * n, 3 * n))


def products_of_gradients(stiffness: csc_array, first: Floats, second: Floats) -> Floats:
    """(n, a, b) integrals, over the areas of vertices, of the products of gradients of values (n, a) and (n, b)."""
    each = first[:, :, None] * (stiffness @ second)[:, None, :] + (stiffness @ first)[:, :, None] * second[:, None, :]
    together = (first[:, :, None] * second[:, None, :]).reshape(len(first), -1)
    return (each - (stiffness @ together).reshape(each.shape)) / 2
