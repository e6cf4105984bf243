# SPDX-License-Identifier: GPL-3.0-or-later
"""Gradients of values on a triangle mesh, averaged at vertices, their products, and the divergence of gradients.

The discrete operators of Botsch and Sorkine, On linear variational surface deformation methods (2008). A solution x of
L x = div g, with the stiffness L, has gradients close to g.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array, diags_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import area_normals, cross, vertex_areas

# Relative to the mean area of triangles: vertices with less area have hardly any gradient, instead of a huge one.
MIN_AREA = 1e-9


def gradient_matrices(vertices: Floats, triangles: Integers) -> tuple[csr_array, csr_array, csr_array]:
    """(n, n) for each axis: the component of the gradient at vertices, of values at vertices (n, 3).

    The gradients of the triangles (m, 3) are averaged around each vertex by area.
    """
    n = len(vertices)
    normals = area_normals(vertices, triangles)
    least = MIN_AREA * np.linalg.norm(normals, axis=1).mean() if len(triangles) else 0.0
    directions = normals / np.maximum(np.linalg.norm(normals, axis=1), least)[:, None]
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    # The area of a triangle times the gradient of the function that is one at a corner, and zero at the others.
    integrals = np.stack([cross(directions, edge) / 2 for edge in (c - b, a - c, b - a)], axis=1)
    areas = np.maximum(vertex_areas(vertices, triangles) * 3, least)
    vertex, corner = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
    values = np.tile(integrals, (1, 3, 1)).reshape(-1, 3) / areas[vertex, None]
    x, y, z = (csr_array((column, (vertex, corner)), shape=(n, n)) for column in values.T)
    return x, y, z


def divergence_matrices(stiffness: csr_array, steps: Floats) -> tuple[csr_array, csr_array, csr_array]:
    """(n, n) for each axis: the contribution of a component of gradients at vertices (n, 3) to their divergence.

    For each vertex i the sum over its neighbours j of w_ij (g_i + g_j) / 2 s_ij. The w_ij are the weights of the edges
    in the stiffness (n, n). Each of its entries has a step s_ij, a row of (e, 3): the difference v_i - v_j of the
    vertices' places, or a part of it.
    """
    halves = (
        csr_array((-stiffness.data * step / 2, stiffness.indices, stiffness.indptr), shape=stiffness.shape)
        for step in steps.T
    )
    x, y, z = (csr_array(half + diags_array(half.sum(axis=1))) for half in halves)
    return x, y, z


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
