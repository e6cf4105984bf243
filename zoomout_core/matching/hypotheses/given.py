# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses from an existing map: the user's, or nearest points in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.maps.zoomout import check_start
from zoomout_core.matching.hypotheses.hypothesis import HYPOTHESES, Hypothesis
from zoomout_core.matching.pair import Pair, positions_of_part, target_in_space
from zoomout_core.spectral.eigenbasis import eigenbasis


def proximity_hypothesis(pair: Pair) -> Hypothesis:
    """Each target vertex corresponds to the nearest point of the source in their common frame."""
    proxy = pair.source_shape.proxy
    places = target_in_space(pair)[pair.target_shape.proxy.full_vertex]
    nearest = SurfaceMap(*proxy.search.closest(places), proxy.full.triangles)
    return _pointwise("nearest points in space", nearest.interpolate(proxy.full.vertices), pair)


def given_hypothesis(pair: Pair, initial_map: SurfaceMap | ArrayLike) -> Hypothesis:
    """The hypothesis of the user's own map, of any kind that `MatchOptions` accepts.

    Raises:
        ValueError: the map does not fit the surfaces.
    """
    vertex = _given_vertices(pair, initial_map)
    target = pair.target_shape
    image = vertex[target.surface_vertex]
    # Images off the source's main part move to the nearest vertex of it.
    on_part = pair.source_shape.proxy.full.vertex_of[image]
    off = on_part < 0
    if off.any():
        tree = cKDTree(positions_of_part(pair.source, pair.source_shape))
        on_part[off] = tree.query(pair.source.vertices[image[off]])[1]
    return _pointwise("a given map", pair.source_shape.proxy.full.vertices[on_part], pair)


def _given_vertices(pair: Pair, initial_map: SurfaceMap | ArrayLike) -> Integers:
    """(n_t,) the source vertex that the given map has for each target vertex."""
    if isinstance(initial_map, SurfaceMap):
        if not np.array_equal(initial_map.source_triangles, pair.source.triangles):
            raise ValueError(
                "The given map refers to triangles of a different source: give the source that it was computed for."
            )
        initial_map = initial_map.vertex
    start = check_start(initial_map, len(pair.source.vertices), len(pair.target.vertices))
    if start.ndim == 1:
        return start
    k_target, k_source = start.shape
    if k_target >= len(pair.target.vertices) or k_source >= len(pair.source.vertices):
        raise ValueError(f"The given functional map is {start.shape}, larger than the meshes allow.")
    return vertex_map_of(start, eigenbasis(pair.source, k_source), eigenbasis(pair.target, k_target))


def _pointwise(origin: str, images: Floats, pair: Pair) -> Hypothesis:
    """The hypothesis that each vertex of the target's mesh goes to a place (n_t, 3) in the source part's frame."""
    source, target = pair.source_shape, pair.target_shape
    vertex = np.asarray(cKDTree(source.proxy.vertices).query(images)[1])
    size = min(HYPOTHESES.dense_size, len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    return Hypothesis(origin, functional_map_of(vertex, source.basis, target.basis, size, size))
