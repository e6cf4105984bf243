# SPDX-License-Identifier: GPL-3.0-or-later
"""Decimation of triangle meshes of any size, in short steps, and where each vertex went.

Quadric error (Garland and Heckbert 1997) decides what goes. Large meshes are thinned before: where many vertices lie
closer than the result can resolve, one of each handful stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import fast_simplification
import numpy as np
from scipy.sparse import coo_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.runtime.progress import advance
from zoomout_core.tuning import Tuning, tuned

# The library keeps its mesh in global variables, so that two threads must not use it at once.
DECIMATING = Lock()


@dataclass(frozen=True)
class DecimationTuning(Tuning, set_by="judgement"):
    """How large meshes are thinned, and in which stages they are decimated.

    Attributes:
        close: vertices that are closer than this part of the spacing of the result are thinned.
        notable: thinning and decimation end where more than this part of the vertices is left by a round.
        most_rounds: of the choice of an independent set; vertices that are undecided then stay.
        per_stage: vertices that a stage takes away, at most, which takes a tenth of a second: quadric decimation cannot
            be interrupted, and holds the interpreter's lock.
    """

    close: float = tuned(0.25, "spacings", 0, 1)
    notable: float = tuned(0.8, "1", 0, 1)
    most_rounds: int = tuned(8, "rounds", 1, 1000)
    per_stage: int = tuned(20_000, "vertices", 1, 10_000_000)


DECIMATION = DecimationTuning()


def decimate(vertices: Floats, triangles: Integers, count: int) -> tuple[Floats, Integers, Integers]:
    """A mesh with about `count` vertices.

    Args:
        vertices: (n, 3) positions.
        triangles: (m, 3) vertex numbers, consistently wound.
        count: how many vertices should stay.

    Returns:
        (n', 3) positions and (m', 3) triangles of the result, and (n,) the vertex that each went into.
    """
    merged = np.arange(len(vertices))
    area = triangle_areas(vertices, triangles).sum()
    close = DECIMATION.close * np.sqrt(area / count)
    most = len(vertices)
    random = np.random.default_rng(0)
    while len(vertices) > DECIMATION.per_stage:
        into = _thin(vertices, triangles, close, random, _done(most, len(vertices), count))
        kept, number = np.unique(into, return_inverse=True)
        if len(kept) < count or len(kept) > DECIMATION.notable * len(vertices):
            break
        triangles = number[triangles]
        triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
        vertices, merged = vertices[kept], number[merged]
        advance(_done(most, len(vertices), count))
    while 2 * count < len(triangles):
        stage = max(count, min(len(vertices) - DECIMATION.per_stage, len(vertices) // 2))
        points, triangles, into = _simplified(vertices, triangles, stage)
        merged = into[merged]
        finished = stage == count or len(points) > DECIMATION.notable * len(vertices)
        vertices = points
        advance(_done(most, len(vertices), count))
        if finished:
            break
    return vertices, triangles, merged


def _done(most: int, left: int, count: int) -> float:
    """The fraction done of a decimation from `most` to `count` vertices."""
    return float(np.clip(np.log(most / left) / max(np.log(most / count), 1e-9), 0, 1))


def _simplified(vertices: Floats, triangles: Integers, count: int) -> tuple[Floats, Integers, Integers]:
    """By quadric error, in one go."""
    with DECIMATING:
        points, fewer, collapses = fast_simplification.simplify(
            vertices, triangles, target_count=2 * count, return_collapses=True
        )
        # Only where vertices went is taken from the replay: a few of its points are far off.
        *_, merged = fast_simplification.replay_simplification(vertices, triangles, collapses)
    return points, fewer, merged


def _thin(vertices: Floats, triangles: Integers, close: float, random: np.random.Generator, done: float) -> Integers:
    """(n,) for each vertex one that stays: itself, or one at the other end of a short edge.

    Those that stay are a maximal independent set of the graph of short edges (Luby 1986).
    """
    n = len(vertices)
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    offset = vertices[tail] - vertices[head]
    short = np.einsum("ex,ex->e", offset, offset) < close**2
    tail, head = tail[short], head[short]
    advance(done)
    ends = np.concatenate([tail, head]), np.concatenate([head, tail])
    graph = coo_array((np.ones(len(ends[0]), dtype=bool), ends), shape=(n, n)).tocsr()
    advance(done)
    inhabited = np.flatnonzero(np.diff(graph.indptr))
    first = graph.indptr[inhabited]

    def most_around(values: Integers) -> Integers:
        most = np.full(n, -1)
        if len(first):
            most[inhabited] = np.maximum.reduceat(values[graph.indices], first)
        return most

    priority = random.permutation(n)
    undecided, stays = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    for _ in range(DECIMATION.most_rounds):
        chosen: Booleans = undecided & (priority > most_around(np.where(undecided, priority, -1)))
        stays |= chosen
        undecided &= ~chosen & (most_around(np.where(chosen, priority, -1)) < 0)
        advance(done)
        if not undecided.any():
            break
    stays |= undecided
    holder = np.empty(n, dtype=np.int64)
    holder[priority] = np.arange(n)
    best = most_around(np.where(stays, priority, -1))
    return np.where(stays, np.arange(n), holder[best])
