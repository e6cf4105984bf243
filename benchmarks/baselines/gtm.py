# SPDX-License-Identifier: GPL-3.0-or-later
"""Game-theoretic matching (GTM): sparse matches that preserve pairwise distances, selected by replicator dynamics.

Rodola, Bronstein, Albarelli, Bergamasco and Torsello, A game-theoretic approach to deformable shape matching (2012).
A strategy is a match of a target point p_i with one of the few source points q_i whose descriptors are most similar.
The payoff of two strategies decreases with the distortion of the distance (Gromov's metric), exp(-(d(p_i, p_j) -
d(q_i, q_j))^2 / 2 s^2), and is zero if they share a point. A population x over all strategies, under the replicator
dynamics x_i <- x_i (A x)_i / x'A x, converges to a local maximum of x'A x with sum x = 1 and small support: a group of
mutually consistent matches.

The paper stops at the group. Here every other vertex is mapped to where its geodesic distances to nearby matches are
preserved best, as in trilateration.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.shot import shot
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.spectral.sampling import farthest_points

# Numbers of farthest points of the target to match, of the source to match them to, and of candidates for each.
TARGET_SAMPLES, SOURCE_SAMPLES, CANDIDATES = 300, 1000, 10
# Relative to the square root of the source's area: radius of the descriptors, and tolerated distortion s of distances.
RADIUS, DISTORTION = 0.1, 0.05
# Rounds of evolution, and the fraction of the largest share above which a strategy survives.
ROUNDS, SURVIVES = 1000, 1e-2
# Distance over which the weight of a match falls where other vertices are placed by it, over the root of the area; all
# that are farther still decide where none is near.
WIDTH, FAR_WEIGHT = 0.1, 1e-9
# Stands for an infinite distance on the source, which no vertex near a match has.
UNREACHED = 1e3


def gtm(source: Surface, target: Surface) -> Integers:
    """Match two surfaces, or a part of one, of the same unit.

    Args:
        source: the surface whose vertices are the images.
        target: the surface to be mapped, or a part of it.

    Returns:
        (n_t,) source vertex of each target vertex; -1 on parts of the target without a match.
    """
    unit = np.sqrt(source.area)
    on_target, on_source = (
        farthest_points(surface.vertices, count)
        for surface, count in ((target, TARGET_SAMPLES), (source, SOURCE_SAMPLES))
    )
    described = [
        shot(surface, RADIUS * unit / np.sqrt(surface.area))[samples]
        for surface, samples in ((target, on_target), (source, on_source))
    ]
    candidates = cKDTree(described[1]).query(described[0], min(CANDIDATES, len(on_source)))[1]
    pairs = np.column_stack(
        [np.repeat(np.arange(len(on_target)), candidates.size // len(on_target)), candidates.ravel()]
    )
    from_target, from_source = (
        dijkstra(edge_graph(surface.vertices, surface.triangles), indices=samples) / unit
        for surface, samples in ((target, on_target), (source, on_source))
    )
    payoff = payoffs(pairs, from_target[:, on_target], from_source[:, on_source])
    group = pairs[agreeing(payoff)]
    return interpolate(from_target[group[:, 0]], from_source[group[:, 1]])


def payoffs(pairs: Integers, between_targets: Floats, between_sources: Floats) -> Floats:
    """(m, m) payoffs of pairs of matches.

    Args:
        pairs: (m, 2) indices of a target's and a source's sample.
        between_targets: (p, p) distances of the target's samples; infinite where there is no path.
        between_sources: (q, q) of the source's.
    """
    p, q = pairs.T
    a, b = between_targets[np.ix_(p, p)], between_sources[np.ix_(q, q)]
    connected = np.isfinite(a) & np.isfinite(b)
    distorted = np.subtract(a, b, out=np.full(a.shape, np.inf), where=connected)
    shared = (p[:, None] == p) | (q[:, None] == q)
    return np.where(shared, 0.0, np.exp(-(distorted**2) / (2 * DISTORTION**2)))


def agreeing(payoff: Floats) -> Integers:
    """(g,) indices of the strategies that survive the replicator dynamics, given nonnegative payoffs (m, m)."""
    share = np.full(len(payoff), 1 / len(payoff))
    for _ in range(ROUNDS):
        earned = share * (payoff @ share)
        total = earned.sum()
        if not total > 0:
            raise ValueError("No two matches agree: the shapes have nothing in common that descriptors know.")
        before, share = share, earned / total
        if np.abs(share - before).sum() < 1e-6:
            break
    return np.flatnonzero(share > SURVIVES * share.max())


def interpolate(from_targets: Floats, from_sources: Floats) -> Integers:
    """(n_t,) the source vertex that preserves a target vertex's distances to matched points; -1 where there are none.

    Args:
        from_targets: (g, n_t) distances of the target's vertices from its matched points,
        from_sources: (g, n_s) those of the source's from the points that these are matched with.
    """
    reached = np.isfinite(from_targets)
    near = np.where(reached, from_targets, 0).T
    weight = np.where(reached, np.exp(-((from_targets / WIDTH) ** 2) / 2), 0).T
    weight += FAR_WEIGHT * reached.T
    far = np.where(np.isfinite(from_sources), from_sources, UNREACHED)
    # sum_g w (d - e)^2, without the term that does not contain e.
    misfit = weight @ far**2 - 2 * (weight * near) @ far
    return np.where(reached.any(axis=0), misfit.argmin(axis=1), -1)
