# SPDX-License-Identifier: GPL-3.0-or-later
"""The smallest eigenpairs of W phi = lambda A phi, with Phi' A Phi = I.

Block Lanczos on the shift-inverted, symmetric operator A^1/2 (W + sigma A)^-1 A^1/2 with full reorthogonalisation
(Grimes, Lewis and Simon 1994). In blocks, the sparse solver takes about half as long for each right-hand side, and
repeated eigenvalues are found that a single vector misses.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.linalg import LinAlgError, cholesky, eigh, qr, solve_triangular
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU

from zoomout_core.arrays import Floats, SingleFloats
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.progress import advance
from zoomout_core.runtime.threads import threads

# Vertices whose eigenvectors are assembled at once; bounds the memory, and the time between two steps.
COLUMN_CHUNK = 1 << 14
# Number of parts into which long vectors are split for products, and blocks of right-hand sides for solves: at most as
# many threads work. Each solve reads the whole factor, so small parts of a block cost more than they gain.
PRODUCTS, SOLVES = 8, 2
UNCONVERGED = "The eigenfunctions did not converge: repair the mesh's slivers, or remesh it."
# Shift of the inverted operator, at unit area. Lambda_k is about 4 pi k; any shift from 0.1 to 200 converges equally
# fast.
SHIFT = 20.0
# Right-hand sides solved at once. Per vector, blocks of 4 to 16 take half the time of single vectors.
BLOCK_SIZE = 16
# Largest residual of a shift-inverted pair, relative to its eigenvalue. On one pair of meshes, maps were as accurate as
# with ARPACK; at 0.03 their mean error was an eighth larger.
RESIDUAL_TOLERANCE = 1e-3
# Computed pairs per requested pair, since the last pairs have all of the remaining error.
SURPLUS = 1.05
# Size of the Krylov space at the first convergence test, per computed pair, and blocks beyond that. Of 30 bases of 60,
# 120 and 200 functions, the first to converge did so there, or one block later. A further block divides the largest
# residual by at most the third number, which determines the next test.
FIRST_TEST_SIZE, FIRST_TEST_BLOCKS = 2.2, 5
BLOCK_GAIN = 4.0
# Matrices with fewer rows are diagonalised densely.
MIN_SPARSE_VERTICES = 1200
# Minimum length of vectors for several threads.
MIN_THREADED_VERTICES = 20_000


def eigenpairs(stiffness: csc_array, areas: Floats, k: int, seed: int = 0) -> tuple[Floats, Floats]:
    """The k < n smallest eigenpairs of W phi = lambda diag(areas) phi, by a block that starts from the seed.

    W (n, n) is symmetric and positive semi-definite; the areas (n,) are positive and sum to one.

    Returns:
        (k,) eigenvalues and (n, k) eigenvectors, each positive at its largest absolute value.
    """
    n = len(areas)
    if not 1 <= k < n:
        raise MeshError(
            "{count} eigenfunctions were requested, but a mesh of {vertices:,} vertices has at most "
            "{most:,}: request fewer.",
            count=k,
            vertices=n,
            most=n - 1,
        )
    root = np.sqrt(areas)
    if n < max(MIN_SPARSE_VERTICES, 4 * k):
        scaled = (diags_array(1 / root) @ stiffness @ diags_array(1 / root)).toarray()
        values, vectors = eigh((scaled + scaled.T) / 2, subset_by_index=(0, k - 1))
        vectors /= root[:, None]
    else:
        values, vectors = _block_lanczos(stiffness, areas, root, k, seed)
    vectors *= np.where(vectors.max(axis=0) < -vectors.min(axis=0), -1.0, 1.0)
    return np.maximum(values, 0), vectors


def _block_lanczos(stiffness: csc_array, areas: Floats, root: Floats, k: int, seed: int) -> tuple[Floats, Floats]:
    """`eigenpairs` of a large mesh, with the square roots (n,) of its areas.

    Each step extends the Krylov basis Q by a block. Once the Ritz pairs have converged, the number of eigenvalues below
    a shift shows whether one is missing.
    """
    n, b = len(root), BLOCK_SIZE
    wanted = min(n - 1, int(SURPLUS * k) + 2)
    factor = factorise(stiffness + SHIFT * diags_array(areas))
    limit = min(n // b - 1, 4 * wanted // b + 16)
    Q = np.empty(((limit + 1) * b, n), dtype=np.float32)  # one basis vector per row
    H = np.zeros(((limit + 1) * b, (limit + 1) * b))  # the operator in that basis
    start = np.random.default_rng(seed).standard_normal((n, b))
    start[:, 0] = root
    Q[:b] = qr(start, mode="economic")[0].T
    next_test = FIRST_TEST_SIZE * wanted + FIRST_TEST_BLOCKS * b
    pool = ThreadPoolExecutor(max_workers=threads())
    try:
        parts = _InParts(pool, n)
        for j in range(limit):
            e = (j + 1) * b
            Y = (root * parts.solve(factor, Q[e - b : e] * root)).astype(np.float32)
            advance(min(0.9, e / (2.8 * wanted)))
            for first in (max(0, e - 2 * b), 0):  # first the neighbouring blocks, then all: both passes are needed
                H[first:e, e - b : e] += parts.orthogonalise(Y, Q[first:e]).T
            Q[e : e + b], R = _orthonormalise(Y)
            H[e : e + b, e - b : e] = R
            if e < next_test and j < limit - 1:
                continue
            projected = (H[:e, :e] + H[:e, :e].T) / 2
            # The last pair usually converges last, and is much cheaper to compute than all.
            residual = _residuals(R, *eigh(projected, subset_by_index=(e - wanted, e - wanted))).max()
            if residual >= RESIDUAL_TOLERANCE:
                blocks = int(np.log(residual / RESIDUAL_TOLERANCE) / np.log(BLOCK_GAIN))
                next_test = e + b * max(1, blocks)
                continue
            mu, S = eigh(projected, subset_by_index=(e - wanted, e - 1))
            advance(min(0.9, e / (2.8 * wanted)))
            if _residuals(R, mu, S).max() >= RESIDUAL_TOLERANCE:
                continue
            mu, S = mu[::-1], S[:, ::-1]
            complete = pool.submit(_is_complete, 1 / mu - SHIFT, k, stiffness, areas)
            eigenvectors = _ritz_vectors(Q[:e], S[:, :k], root)
            if complete.result():
                return 1 / mu[:k] - SHIFT, eigenvectors
            next_test = e + 4 * b
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    raise MeshError(UNCONVERGED)


def _orthonormalise(Y: SingleFloats) -> tuple[SingleFloats, Floats]:
    """Orthonormal rows (b, n), and the triangular R (b, b) by which R^T times these rows is Y (b, n).

    CholeskyQR2 (Yamamoto, Nakatsukasa, Yanagisawa and Fukaya 2015): the second round removes the rounding of the first.

    Raises:
        MeshError: the rows are linearly dependent.
    """
    b = len(Y)
    R = np.eye(b)
    for _ in range(2):
        try:
            L = cholesky((Y @ Y.T).astype(np.float64), lower=True)
        except LinAlgError:  # slivers have exhausted the precision
            raise MeshError(UNCONVERGED) from None
        Y = solve_triangular(L, np.eye(b), lower=True).astype(np.float32) @ Y
        R = L.T @ R
    return Y, R


def _ritz_vectors(Q: SingleFloats, S: Floats, root: Floats) -> Floats:
    """(n, k) eigenvectors from their coefficients S (e, k) in the basis Q (e, n), with the areas' roots (n,)."""
    n = len(root)
    weights = np.asarray(S, dtype=np.float32)
    eigenvectors = np.empty((n, S.shape[1]))
    for columns in np.array_split(np.arange(n), max(1, n // COLUMN_CHUNK)):
        rows = slice(columns[0], columns[-1] + 1)
        np.divide(Q[:, rows].T @ weights, root[rows, None], out=eigenvectors[rows])
        advance(0.95)
    return eigenvectors


class _InParts:
    """Operations on blocks of long vectors, split into parts for several threads.

    The parts and the order of summation do not depend on the number of threads, and so neither do the results.
    """

    def __init__(self, pool: ThreadPoolExecutor, n: int) -> None:
        is_long = n >= MIN_THREADED_VERTICES
        self._map = pool.map if is_long else map
        self._solves = SOLVES if is_long else 1
        parts = np.array_split(np.arange(n), PRODUCTS if is_long else 1)
        self._parts = [slice(part[0], part[-1] + 1) for part in parts]

    def solve(self, factor: SuperLU, rows: Floats) -> Floats:
        """(b, n) solutions for right-hand sides (b, n)."""
        return np.concatenate(list(self._map(lambda some: factor.solve(some.T).T, np.array_split(rows, self._solves))))

    def orthogonalise(self, rows: SingleFloats, basis: SingleFloats) -> SingleFloats:
        """Remove the span of a basis (e, n) from vectors (b, n) in place; returns the removed coefficients (b, e)."""
        products = sum(self._map(lambda part: rows[:, part] @ basis[:, part].T, self._parts))

        def take_away(part: slice) -> None:
            rows[:, part] -= products @ basis[:, part]

        list(self._map(take_away, self._parts))
        return np.asarray(products)


def _is_complete(eigenvalues: Floats, k: int, stiffness: csc_array, areas: Floats) -> bool:
    """Whether no eigenvalue is missing among the first k or more of those found, ascending.

    By Sylvester's law of inertia, the number of eigenvalues below a shift is that of negative pivots of the shifted
    matrix.
    """
    count = k + int(np.argmax(np.diff(eigenvalues[k - 1 :])))  # the shift is in the widest gap after the k-th
    shift = (eigenvalues[count - 1] + eigenvalues[count]) / 2
    factor = factorise(stiffness - shift * diags_array(areas))
    if not np.array_equal(factor.perm_r, factor.perm_c):
        return True  # pivots off the diagonal do not determine the signs
    return int((factor.U.diagonal() < 0).sum()) == count


def _residuals(R: Floats, mu: Floats, S: Floats) -> Floats:
    """(p,) relative residuals of Ritz pairs with vectors S (e, p) in the Lanczos basis."""
    return np.asarray(np.linalg.norm(R @ S[-len(R) :], axis=0) / mu)
