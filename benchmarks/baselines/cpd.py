# SPDX-License-Identifier: GPL-3.0-or-later
"""Coherent point drift (CPD), non-rigid.

Myronenko and Song, Point set registration: coherent point drift (2010). The source's points y_m are the centres of a
Gaussian mixture that the target's points x_n are drawn from, and move by y + v(y), with v(z) = sum_m exp(-||z - y_m||^2
/ 2 beta^2) w_m. Expectation: the probabilities P_mn that the centre m gave rise to x_n. Maximisation: the weights W of

    (d(P 1) G + lambda sigma^2 I) W = P X - d(P 1) Y,

and the variance sigma^2. The kernel G is approximated by its largest eigenpairs (section 6), and the iteration
runs on farthest points; v moves all others. The method uses positions only, so it needs similar poses.

It is implemented here because `pycpd` stores all pairwise differences, (m, n, 3) numbers in each expectation step,
and moves only the points that it was given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, solve
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from zoomout_core.arrays import Floats, Integers
from zoomout_core.spectral.sampling import farthest_points

# The authors' values, for points of mean zero and variance one: width of the kernel, weight of coherence, and share
# of outliers.
BETA, LAMBDA, OUTLIERS = 2.0, 3.0, 0.1
# Eigenpairs of the kernel, farthest points of each shape, and iterations.
RANK, SAMPLES, ITERATIONS = 100, 1500, 100
# The iteration ends at this sigma^2, where only nearest points matter.
MIN_VARIANCE = 1e-5


@dataclass(frozen=True, eq=False)
class Drift:
    """A displacement of space.

    Attributes:
        centres: (m, 3) of the kernel.
        weights: (m, 3) W.
    """

    centres: Floats
    weights: Floats

    def move(self, points: Floats) -> Floats:
        """(n, 3) points (n, 3) after the displacement."""
        return points + kernel(points, self.centres) @ self.weights


def cpd(source: Floats, target: Floats, samples: int = SAMPLES) -> Integers:
    """Deform the source onto the target, and take the nearest points.

    Args:
        source: (n_s, 3) points that are the images.
        target: (n_t, 3) points to be mapped, in about the same pose and position.
        samples: number of farthest points of each on which the iteration runs.

    Returns:
        (n_t,) source point of each target point.
    """
    source, target = _normalise(source), _normalise(target)
    drift = register(source[farthest_points(source, samples)], target[farthest_points(target, samples)])
    return np.asarray(cKDTree(drift.move(source)).query(target)[1])


def register(moving: Floats, fixed: Floats, iterations: int = ITERATIONS) -> Drift:
    """The displacement that moves points (m, 3) onto others (n, 3), both of about zero mean and unit variance."""
    values, vectors = _low_rank(kernel(moving, moving))
    weights = np.zeros_like(moving)
    moved = moving
    variance = float(cdist(moving, fixed, "sqeuclidean").mean() / moving.shape[1])
    for _ in range(iterations):
        share = probabilities(moved, fixed, variance)
        of_moving = share.sum(axis=1)
        # With G = Q L Q', only a matrix of the rank's size is inverted (Woodbury).
        right = share @ fixed - of_moving[:, None] * moving
        penalty = LAMBDA * variance
        small = np.diag(penalty / values) + vectors.T @ (of_moving[:, None] * vectors)
        inner = solve(small, vectors.T @ right, assume_a="pos")
        weights = (right - of_moving[:, None] * (vectors @ inner)) / penalty
        moved = moving + vectors @ (values[:, None] * (vectors.T @ weights))
        apart = cdist(moved, fixed, "sqeuclidean")
        variance = float((share * apart).sum() / (share.sum() * moving.shape[1]))
        if variance < MIN_VARIANCE:
            break
    return Drift(moving, weights)


def probabilities(centres: Floats, points: Floats, variance: float) -> Floats:
    """(m, n) probabilities that a centre (m, 3) generated a point (n, 3); the rest up to one is that of an outlier."""
    m, d = centres.shape
    likelihood = np.exp(cdist(centres, points, "sqeuclidean") / (-2 * variance))
    uniform = (2 * np.pi * variance) ** (d / 2) * OUTLIERS / (1 - OUTLIERS) * m / len(points)
    return np.asarray(likelihood / (likelihood.sum(axis=0) + uniform))


def kernel(points: Floats, centres: Floats) -> Floats:
    """(n, m) the Gaussian of the distance of two points."""
    return np.asarray(np.exp(cdist(points, centres, "sqeuclidean") / (-2 * BETA**2)))


def _low_rank(matrix: Floats) -> tuple[Floats, Floats]:
    """(r,) the largest eigenvalues above rounding errors, and their eigenvectors (m, r)."""
    m = len(matrix)
    values, vectors = eigh(matrix, subset_by_index=(max(0, m - RANK), m - 1))
    kept = values > 1e-10 * values[-1]
    return values[kept], vectors[:, kept]


def _normalise(points: Floats) -> Floats:
    """Points (n, d) of zero mean and of unit variance over all coordinates."""
    centred = points - points.mean(axis=0)
    return np.asarray(centred / np.sqrt((centred**2).mean()))
