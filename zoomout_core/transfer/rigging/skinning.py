# SPDX-License-Identifier: GPL-3.0-or-later
"""Skinning: how bones move a surface.

A vertex moves by the mean of the transforms of its bones, weighted by its skin weights. The transforms are matrices
(linear blend skinning), or dual quaternions, which preserve volume: Kavan et al., Geometric skinning with approximate
dual quaternion blending (2008).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.mesh.affine_maps import blend_matrices, normalise


def skinning_matrices(transforms: Similarities, weights: csr_array, *, preserve_volume: bool = False) -> Floats:
    """(n, 3, 4) affine maps that take each vertex from rest to the pose; zero where a vertex has no weight.

    Args:
        transforms: transforms of the bones (b,) from the rest pose to the pose, with one common scale.
        weights: (n, b) sparse skin weights, not negative; they need not sum to one.
        preserve_volume: blend dual quaternions in place of matrices.
    """
    if preserve_volume:
        return _blend_dual_quaternions(transforms, normalise(weights))
    return blend_matrices(matrices_of(transforms), weights)


def matrices_of(transforms: Similarities) -> Floats:
    """(b, 3, 4) affine maps of similarities."""
    return np.concatenate([transforms.linear, transforms.translation[:, :, None]], axis=2)


def renumber_bones(weights: csr_array, numbers: Integers, count: int) -> csr_array:
    """(n, count) weights (n, b) by other numbers (b,) of the bones.

    Weights of bones with the same number are added, and those of bones with the number -1 are left out.
    """
    given = weights.tocoo()
    column = numbers[given.col]
    kept = column >= 0
    entries = given.data[kept].astype(np.float64), (given.row[kept], column[kept])
    return csr_array(coo_array(entries, shape=(given.shape[0], count)))


def row_of(matrix: csr_array) -> Integers:
    """(entries,) the row of each entry of a sparse matrix."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def _blend_dual_quaternions(transforms: Similarities, shares: csr_array) -> Floats:
    """(n, 3, 4) rigid motions of blended dual quaternions, after the common scale.

    Signs of quaternions are chosen closest to that of the strongest bone.
    """
    real = Rotation.from_matrix(transforms.rotation).as_quat()  # x, y, z, w
    dual = 0.5 * _product(np.column_stack([transforms.translation, np.zeros(len(real))]), real)
    facing = np.einsum("ex,ex->e", real[shares.indices], real[strongest(shares)[row_of(shares)]])
    signed = csr_array((np.where(facing < 0, -1, 1) * shares.data, shares.indices, shares.indptr), shape=shares.shape)
    weighted = np.diff(shares.indptr) > 0
    real, dual = np.asarray(signed @ real)[weighted], np.asarray(signed @ dual)[weighted]
    length = np.linalg.norm(real, axis=1, keepdims=True)
    matrices = np.zeros((len(weighted), 3, 4))
    matrices[weighted, :, :3] = transforms.scale[0] * Rotation.from_quat(real).as_matrix()
    matrices[weighted, :, 3] = 2 * _product(dual / length, real / length * [-1, -1, -1, 1])[:, :3]
    return matrices


def strongest(shares: csr_array) -> Integers:
    """(n,) the column of the largest weight of each row; 0 for an empty row."""
    found: Integers = np.zeros(shares.shape[0], dtype=np.int64)
    ascending = np.argsort(shares.data, kind="stable")
    found[row_of(shares)[ascending]] = shares.indices[ascending]
    return found


def _product(a: Floats, b: Floats) -> Floats:
    """(n, 4) products of quaternions x, y, z, w."""
    vector = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    return np.column_stack([vector, a[:, 3] * b[:, 3] - np.einsum("nx,nx->n", a[:, :3], b[:, :3])])
