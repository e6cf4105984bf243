# SPDX-License-Identifier: GPL-3.0-or-later
"""Bijective and continuous iterative closest points (BCICP).

Ren, Poulenard, Wonka and Ovsjanikov, Continuous and orientation-preserving correspondences via functional maps (2018).
Maps in both directions refine each other: their functional maps are rotated towards inverses of each other, nearest
neighbours are searched in both embeddings at once, and vertex maps are repaired: small patches that differ from their
surroundings and jumps along edges are smoothed, and vertices that are not covered are assigned to a target vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from benchmarks.baselines.spectral_icp import nearest_orthonormal
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.zoomout import Refined
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, unique_edges
from zoomout_core.spectral.eigenbasis import SpectralBasis

# An edge is a jump if its image is longer than this multiple of the mean edge of the other surface.
JUMP = 5.0
# Pieces between jumps with less than this share of the vertices are outliers.
OUTLIERS = 0.01
# Rounds of smoothing.
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two shapes.

    Attributes:
        surface: its mesh.
        basis: its eigenfunctions.
    """

    surface: Surface
    basis: SpectralBasis


def bcicp(
    source: Side, target: Side, initial: Integers, initial_back: Integers, k: int = 50, iterations: int = 10
) -> tuple[Refined, Refined]:
    """Refine two vertex maps, one in each direction, together.

    Args:
        source: the shape whose vertices are the images.
        target: the shape on which the map is defined.
        initial: (n_t,) source vertex of each target vertex.
        initial_back: (n_s,) target vertex of each source vertex.
        k: size of the functional maps.
        iterations: at least one.

    Returns:
        The map from target to source, and the map back.
    """
    there, back = initial, initial_back
    rows_source, rows_target = (side.basis.eigenvectors[:, :k] for side in (source, target))
    for _ in range(iterations):
        C = functional_map_of(there, source.basis, target.basis, k, k)
        D = functional_map_of(back, target.basis, source.basis, k, k)
        C, D = turn_to_inverse(C, D), turn_to_inverse(D, C)
        embedded_source = np.hstack([rows_source @ C.T, rows_source])
        embedded_target = np.hstack([rows_target, rows_target @ D.T])
        found = nearest(embedded_target, embedded_source), nearest(embedded_source, embedded_target)
        smooth = (
            smooth_map(found[0], source.surface, target.surface),
            smooth_map(found[1], target.surface, source.surface),
        )
        there, back = covering(*smooth), covering(*smooth[::-1])
    return Refined(C, there), Refined(D, back)


def turn_to_inverse(functional_map: Floats, back: Floats) -> Floats:
    """The rotation of a functional map C (k_t, k_s) that brings it nearest to the inverse of D (k_s, k_t).

    With the polar decomposition D C = P R it is C R': D C R' = P is symmetric positive semidefinite.
    """
    return functional_map @ nearest_orthonormal(back @ functional_map).T


def smooth_map(vertex: Integers, source: Surface, target: Surface) -> Integers:
    """A vertex map (n_t,) without small patches that differ from their surroundings, and with fewer jumps.

    Jumps separate patches; a small one takes the images of its nearest surroundings. Each vertex at a jump then
    takes the medoid of its own image and its neighbours' images.
    """
    edges, _ = unique_edges(target.triangles)
    pieces = connected_components(_graph(edges[~_jumps(vertex, edges, source)], len(vertex)), directed=False)[1]
    small = np.bincount(pieces) < OUTLIERS * len(vertex)
    if small[pieces].all():
        return vertex
    kept = np.flatnonzero(~small[pieces])
    graph = edge_graph(target.vertices, target.triangles)
    _, _, nearest_kept = dijkstra(graph, directed=False, indices=kept, return_predecessors=True, min_only=True)
    vertex = np.where(nearest_kept >= 0, vertex[nearest_kept], vertex)
    for _ in range(ROUNDS):
        vertex = _with_medians(vertex, edges, source)
    return vertex


def covering(vertex: Integers, back: Integers) -> Integers:
    """A vertex map (n_t,) that covers more of the source, by means of the map back (n_s,).

    The partner (by the map back) of an uncovered source vertex is moved to it if the partner's old image stays covered.
    """
    preimages = np.bincount(vertex, minlength=len(back))
    covered = vertex.copy()
    for missed in np.flatnonzero(preimages == 0):
        partner = back[missed]
        if preimages[covered[partner]] > 1:
            preimages[covered[partner]] -= 1
            preimages[missed] += 1
            covered[partner] = missed
    return covered


def _jumps(vertex: Integers, edges: Integers, source: Surface) -> Booleans:
    """(e,) which of the target's edges (e, 2) a vertex map tears."""
    own, _ = unique_edges(source.triangles)
    mean = np.linalg.norm(source.vertices[own[:, 0]] - source.vertices[own[:, 1]], axis=1).mean()
    images = source.vertices[vertex]
    return np.asarray(np.linalg.norm(images[edges[:, 0]] - images[edges[:, 1]], axis=1) > JUMP * mean)


def _with_medians(vertex: Integers, edges: Integers, source: Surface) -> Integers:
    """A vertex map (n_t,) in which vertices at jumps have the median of their own image and their neighbours'."""
    rings = _graph(edges, len(vertex))
    changed = vertex.copy()
    for at_jump in np.unique(edges[_jumps(vertex, edges, source)]):
        ring = rings.indices[rings.indptr[at_jump] : rings.indptr[at_jump + 1]]
        around = vertex[np.append(ring, at_jump)]
        images = source.vertices[around]
        apart = np.linalg.norm(images[:, None] - images, axis=2).sum(axis=1)
        changed[at_jump] = around[np.argmin(apart)]
    return changed


def _graph(edges: Integers, n: int) -> csr_array:
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    return csr_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
