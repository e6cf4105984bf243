# SPDX-License-Identifier: GPL-3.0-or-later
"""Decimate triangle meshes of any size in short steps, and track where each vertex goes.

Quadric error (Garland and Heckbert 1997) decides which vertices to remove. Large meshes are thinned first: of vertices
that are closer than the result can resolve, one of each cluster stays.
"""

from __future__ import annotations

from threading import Lock

import fast_simplification
import numpy as np
from scipy.sparse import coo_array

from zoomout_core.arrays import Floats, Indices, Integers, row_norms, take_rows
from zoomout_core.mesh.triangles import area_normals, have_three_corners, triangle_areas
from zoomout_core.runtime.progress import advance

# The library keeps its mesh in global variables, so only one thread may use it at a time.
DECIMATING = Lock()
# Edge length, in vertex spacings of the result, below which thinning merges the ends.
MIN_EDGE = 0.25
# Thinning and decimation end when a round leaves more than this share of the vertices: another would gain little.
MAX_REMAINING_SHARE = 0.8
# Rounds of choosing an independent set; vertices that are still undecided afterwards stay.
INDEPENDENT_SET_ROUNDS = 8
# Maximum vertices removed in one stage, a tenth of a second: quadric decimation cannot be interrupted and holds the
# interpreter's lock.
MAX_STAGE_VERTICES = 20_000
# Standard deviation of random displacements of vertices before their quadrics are computed, along each axis, in vertex
# spacings. Quadrics do not determine positions on flat facets, so that rounding would. On six game characters remeshed
# by voxels, 8 to 65 % of the vertices went elsewhere at other scales; now 0 to 2 % do. The mean distance between a mesh
# and its proxy grows by 1 %; it is 5 % with 0.03.
JITTER = 0.01
# Share of flat vertices above which a mesh is displaced: scans and sculpted bodies have at most 0.002, and low-poly
# characters as one skin 0.03 to 0.15. The area vectors around a flat vertex add up to their areas, less this share.
MIN_FLAT, FLAT = 0.01, 1e-6


def decimate(vertices: Floats, triangles: Integers, count: int) -> tuple[Floats, Integers, Integers]:
    """Reduce a mesh of consistently wound triangles (m, 3) on vertices (n, 3) to about `count` vertices.

    Args:
        vertices: positions.
        triangles: vertex numbers.
        count: number of vertices of the result.

    Returns:
        (n', 3) positions and (m', 3) triangles of the result, and (n,) the vertex that each was merged into.
    """
    merged = np.arange(len(vertices))
    area = triangle_areas(vertices, triangles).sum()
    close = MIN_EDGE * np.sqrt(area / count)
    original = len(vertices)
    random = np.random.default_rng(0)
    while len(vertices) > MAX_STAGE_VERTICES:
        into = _thin(vertices, triangles, close, random, _progress(original, len(vertices), count))
        is_kept = np.zeros(len(vertices), dtype=bool)
        is_kept[into] = True
        kept, number = np.flatnonzero(is_kept), (np.cumsum(is_kept) - 1)[into]
        if len(kept) < count or len(kept) > MAX_REMAINING_SHARE * len(vertices):
            break
        triangles = take_rows(number, triangles)
        triangles = triangles[have_three_corners(triangles)]
        vertices, merged = vertices[kept], number[merged]
        advance(_progress(original, len(vertices), count))
    if 2 * count < len(triangles) and _share_of_flat(vertices, triangles) > MIN_FLAT:
        vertices = vertices + JITTER * np.sqrt(area / len(vertices)) * random.standard_normal(vertices.shape)
    while 2 * count < len(triangles):
        stage = max(count, min(len(vertices) - MAX_STAGE_VERTICES, len(vertices) // 2))
        points, triangles, into = _simplify(vertices, triangles, stage)
        merged = into[merged]
        finished = stage == count or len(points) > MAX_REMAINING_SHARE * len(vertices)
        vertices = points
        advance(_progress(original, len(vertices), count))
        if finished:
            break
    return vertices, triangles, merged


def _progress(original: int, left: int, count: int) -> float:
    """The completed fraction of a decimation from `original` to `count` vertices."""
    return float(np.clip(np.log(original / left) / max(np.log(original / count), 1e-9), 0, 1))


def _share_of_flat(vertices: Floats, triangles: Integers) -> float:
    """The share of the vertices whose triangles are in one plane."""
    normals = area_normals(vertices, triangles)
    of_lengths, *of_axes = (np.repeat(values, 3) for values in (row_norms(normals), *normals.T))
    areas = np.bincount(triangles.ravel(), of_lengths, len(vertices)).astype(np.float64)
    sums = np.stack([np.bincount(triangles.ravel(), axis, len(vertices)) for axis in of_axes], axis=1)
    return float((row_norms(sums.astype(np.float64)) >= (1 - FLAT) * areas).mean())


def _simplify(vertices: Floats, triangles: Integers, count: int) -> tuple[Floats, Integers, Integers]:
    """Decimate by quadric error in one step."""
    with DECIMATING:
        points, fewer, collapses = fast_simplification.simplify(
            vertices, triangles, target_count=2 * count, return_collapses=True
        )
        # Use only the vertex mapping of the replay: a few of its points are far off.
        *_, merged = fast_simplification.replay_simplification(vertices, triangles, collapses)
    return points, fewer, merged


def _thin(vertices: Floats, triangles: Integers, close: float, random: np.random.Generator, done: float) -> Integers:
    """(n,) the vertex that replaces each vertex: itself, or one at the other end of a short edge.

    The vertices that stay are a maximal independent set of the graph of short edges (Luby 1986).
    """
    n = len(vertices)
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    short = row_norms(take_rows(vertices, tail) - take_rows(vertices, head)) < close
    tail, head = tail[short], head[short]
    advance(done)
    ends = np.concatenate([tail, head]), np.concatenate([head, tail])
    graph = coo_array((np.ones(len(ends[0]), dtype=bool), ends), shape=(n, n)).tocsr()
    advance(done)
    place, beside = np.repeat(np.arange(n), np.diff(graph.indptr)), graph.indices
    priority = random.permutation(n)
    undecided, stays = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    near, far = place, beside  # the edges between undecided vertices
    for _ in range(INDEPENDENT_SET_ROUNDS):
        stays |= undecided & (priority > _max_around(near, priority[far], n))
        undecided &= ~stays
        undecided[far[stays[near]]] = False
        open_ended = undecided[near] & undecided[far]
        near, far = near[open_ended], far[open_ended]
        advance(done)
        if not undecided.any():
            break
    stays |= undecided
    holder = np.empty(n, dtype=np.int64)
    holder[priority] = np.arange(n)
    best = _max_around(place, np.where(stays, priority, -1)[beside], n)
    return np.where(stays, np.arange(n), holder[best])


def _max_around(vertex: Indices, values: Integers, n: int) -> Integers:
    """(n,) the largest of the values (e,) at each vertex, by the vertex (e,) of each, ascending; -1 without a value."""
    highest = np.full(n, -1)
    if len(vertex):
        first = np.flatnonzero(np.diff(vertex, prepend=-1))
        highest[vertex[first]] = np.maximum.reduceat(values, first)
    return highest
