# SPDX-License-Identifier: GPL-3.0-or-later
"""Check transferred skin weights before they are written: play the bones, and find the edges that stretch too far.

A patch with the weights of another limb is invisible at rest, and shoots across the screen in the first pose. The bones
of the source are therefore rotated to extremes, and source and target follow by linear blend skinning. An edge is
stretched if it grows much more than the source does at its image. Weights there are filled in from the surroundings.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import components, edge_lengths, unique_edges
from zoomout_core.transfer.inpaint import filling
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class StretchTuning(Tuning, set_by="everywhere"):
    """When an edge counts as stretched, and how far around it weights are filled in.

    Attributes:
        times: an edge is stretched if it grows by more than this multiple of the source's growth there,
        min_growth: and by more than this ratio,
        min_length: and is longer in a pose than this fraction of the surface's size.
        rings: edges around a stretched one within which weights are filled in at first,
        widening: factor by which this number grows in each further round. A wide repair replaces right weights, but the
            skin over the joints of a robot of rigid parts needs up to 38 edges.
        rounds: maximum number of repairs while edges are stretched.
    """

    times: float = tuned(2.0, "1", 1, 100)
    min_growth: float = tuned(2.0, "1", 1, 100)
    min_length: float = tuned(0.02, "1", 0, 1)
    rings: int = tuned(1, "edges", 0, 100)
    widening: float = tuned(1.5, "1", 1, 10)
    rounds: int = tuned(10, "rounds", 0, 20)


STRETCH = StretchTuning()


class CheckedWeights(NamedTuple):
    """Skin weights, smoothed where they would tear the target."""

    weights: csr_array  # (n_t, b) sparse
    smoothed: Booleans  # (n_t,) vertices whose weights were filled in from their surroundings
    stretched: Booleans  # (n_t,) vertices at edges that stretch too far still


class Played(NamedTuple):
    """A surface in some poses."""

    edges: Integers  # (e, 2) vertex numbers
    growth: Floats  # (e,) the largest ratio of an edge's length in a pose to that at rest
    length: Floats  # (e,) its largest length in a pose


def check_weights(
    source: Surface,
    source_weights: csr_array,
    target: Surface,
    weights: csr_array,
    surface_map: SurfaceMap,
    poses: Floats,
    target_poses: Floats | None = None,
) -> CheckedWeights:
    """Play a source and a target, and smooth the target's weights around edges that stretch too far.

    Each patch around such edges keeps its smoothed weights only if its edges stretch less with them.

    Both surfaces are at rest, with skin weights (n_s, b) and (n_t, b); the map leads from the target to the source. The
    poses (f, b, 3, 4) are transforms of the bones from rest; those of the target, if its bones are elsewhere.
    """
    played = play(source, source_weights, poses)
    size = float(np.ptp(target.vertices, axis=0).max())
    smoothed = np.zeros(len(target.vertices), dtype=bool)
    edges, _ = unique_edges(target.triangles)
    poses = poses if target_poses is None else target_poses

    def find_excess(tried: csr_array) -> Floats:
        return excess_growth(played, play(target, tried, poses), surface_map, size)

    excess = find_excess(weights)
    for number in range(STRETCH.rounds):
        if not excess.any():
            break
        around = _around(target, edges[excess > 0], round(STRETCH.rings * STRETCH.widening**number))
        filled = smooth_weights(weights, target, around)
        left = find_excess(filled)
        better = _gains(around, edges, excess - left) > 0
        if better.any():
            weights, smoothed = _replace_rows(weights, filled, better), smoothed | better
            excess = np.where(better[edges].any(axis=1), left, excess)  # no edge joins two patches
    return CheckedWeights(weights, smoothed, _around(target, edges[excess > 0], 0))


def play_offsets(rest: Surface, keys: Iterable[Floats]) -> Iterator[Played]:
    """Move a surface by the offsets (n, 3) of each of several shape keys, and measure its edges."""
    edges, _ = unique_edges(rest.triangles)
    own = np.maximum(edge_lengths(rest.vertices, edges), 1e-300)
    for offsets in keys:
        moved = edge_lengths(rest.vertices + offsets, edges)
        yield Played(edges, moved / own, moved)


def play(rest: Surface, weights: csr_array, poses: Floats) -> Played:
    """Pose a surface by linear blend skinning, and measure its edges; vertices without weights stay in place.

    The weights are (n, b), and the poses (f, b, 3, 4) transforms of the bones from rest.
    """
    edges, _ = unique_edges(rest.triangles)
    weighted = np.asarray(weights.sum(axis=1)).ravel() > 0
    own = edge_lengths(rest.vertices, edges)
    growth, length = np.ones(len(edges)), own.copy()
    for transforms in poses:
        moved = transform_points(blend_matrices(transforms, weights), rest.vertices)
        posed = edge_lengths(np.where(weighted[:, None], moved, rest.vertices), edges)
        length = np.maximum(length, posed)
        growth = np.maximum(growth, posed / np.maximum(own, 1e-300))
    return Played(edges, growth, length)


def stretched_edges(source: Played, target: Played, surface_map: SurfaceMap, size: float) -> Booleans:
    """(e,) which edges of a target stretch much more than the source does at their images, in the same poses.

    The size is that of the target, such as its height.
    """
    return excess_growth(source, target, surface_map, size) > 0


def excess_growth(source: Played, target: Played, surface_map: SurfaceMap, size: float) -> Floats:
    """(e,) logarithm of the ratio by which each edge of a target stretches too far; 0 where it does not.

    The size is that of the target, such as its height.
    """
    at_vertex = np.ones(int(surface_map.source_triangles.max()) + 1)
    for end in source.edges.T:
        np.maximum.at(at_vertex, end, source.growth)
    around = at_vertex[surface_map.source_triangles[surface_map.triangle]].max(axis=1)
    allowed = np.maximum(STRETCH.times * around[target.edges].max(axis=1), STRETCH.min_growth)
    ratio = np.where(target.length > STRETCH.min_length * size, target.growth / allowed, 1.0)
    return np.log(np.maximum(ratio, 1.0))


def smooth_weights(weights: csr_array, target: Surface, chosen: Booleans) -> csr_array:
    """Weights (n, groups), filled in at some vertices (n,) from the others; each vertex keeps its sum."""
    filled = filling(target, ~chosen).fill_weights(csr_array(weights))
    before, after = (np.asarray(each.sum(axis=1)).ravel() for each in (weights, filled))
    scale = np.where((after > 0) & (before > 0), before / np.maximum(after, 1e-300), 1.0)
    filled.data *= np.repeat(scale, np.diff(filled.indptr))
    return csr_array(filled)


def _gains(around: Booleans, edges: Integers, gain: Floats) -> Floats:
    """(n,) the sum of the gains (e,) at the edges (e, 2) of each vertex's patch of chosen vertices (n,), else 0."""
    patch = components(edges[around[edges].all(axis=1)], len(around))
    touched = around[edges].any(axis=1)
    of_edge = patch[np.where(around[edges[:, 0]], edges[:, 0], edges[:, 1])[touched]]
    return np.where(around, np.bincount(of_edge, gain[touched], len(around))[patch], 0.0)


def _replace_rows(weights: csr_array, by: csr_array, chosen: Booleans) -> csr_array:
    """Weights (n, b) with some rows (n,) replaced by those of others."""
    n = len(chosen)
    return csr_array(vstack([weights, by], format="csr")[np.arange(n) + n * chosen])


def _around(target: Surface, edges: Integers, rings: int) -> Booleans:
    """(n,) the vertices within some rings of edges (e, 2)."""
    chosen = np.isin(np.arange(len(target.vertices)), edges)
    every, _ = unique_edges(target.triangles)
    for _ in range(rings):
        chosen[every[chosen[every].any(axis=1)]] = True
    return chosen
