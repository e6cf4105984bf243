"""How good a map is: the field's usual figures."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.surface import Floats, Integers, Surface, edge_graph

# Distances are sought from at most this many places at once: bounds the memory.
BLOCK = 256


def geodesic_error(
    surface_map: SurfaceMap | Integers,
    source: Surface,
    target_vertex: Integers,
    source_vertex: Integers,
    most: int = 1000,
) -> Floats:
    """Geodesic distance between a map's images and the true ones, over the square root of the source's area.

    Distances run along edges (Dijkstra), and an image counts as its nearest vertex.

    Args:
        surface_map: the map, or (n_t,) the source vertex of each target vertex.
        source: the surface that the map lands on.
        target_vertex: (c,) target vertices whose place on the source is known.
        source_vertex: (c,) that place.
        most: measure at most this many of the pairs, evenly spread over the list.

    Returns:
        (min(c, most),) errors; their mean times 1000 is what papers quote.
    """
    vertex = surface_map.vertex if isinstance(surface_map, SurfaceMap) else np.asarray(surface_map)
    picked = np.unique(np.linspace(0, len(target_vertex) - 1, min(most, len(target_vertex))).astype(int))
    image, truth = vertex[np.asarray(target_vertex)[picked]], np.asarray(source_vertex)[picked]
    graph = edge_graph(source.vertices, source.triangles)
    error = np.empty(len(picked))
    for start in range(0, len(picked), BLOCK):
        block = slice(start, start + BLOCK)
        distance = dijkstra(graph, directed=False, indices=truth[block])
        error[block] = distance[np.arange(distance.shape[0]), image[block]]
    return error / np.sqrt(source.area)
