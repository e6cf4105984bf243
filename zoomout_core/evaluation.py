# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluate the quality of a map by the usual measures of the field.

Geodesic error: Kim, Lipman and Funkhouser, Blended intrinsic maps (2011). Coverage and edge distortion: Ren, Poulenard,
Wonka and Ovsjanikov, Continuous and orientation-preserving correspondences via functional maps (2018), in forms that
depend little on the triangulation. For the error of going there and back see
`zoomout_core.matching.refinement.confidence.cycle_error`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans, Floats, Integers, check_counts, to_array
from zoomout_core.maps.surface_map import SurfaceMap, folded_triangles
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.shapes import ShapeLike, as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, triangle_areas, unique_edges
from zoomout_core.runtime.option_names import suggest_names

# Places whose distances are computed at once; bounds the memory.
BLOCK = 256
# Numbers of places that the distortion of distances is measured from, and to; more take longer and change little.
DISTANCES = 40, 1000


class HasMap(Protocol):
    """A result that has a map, such as that of a match."""

    @property
    def surface_map(self) -> SurfaceMap: ...


@suggest_names
def geodesic_error(
    surface_map: SurfaceMap | HasMap | Integers,
    source: ShapeLike,
    target_vertex: Integers,
    source_vertex: Integers,
    max_count: int = 1000,
) -> Floats:
    """Geodesic distance between a map's images and the true ones, relative to the square root of the source's area.

    Distances run along edges (Dijkstra), and an image counts as its nearest vertex.

    Args:
        surface_map: the map, or a result that has one, or (n_t,) the source vertex of each target vertex; (n_t, m) for
            m maps at once.
        source: the surface that the map lands on, see `ShapeLike`.
        target_vertex: (c,) target vertices with a known place on the source.
        source_vertex: (c,) this place.
        max_count: maximum number of pairs to measure; they are evenly spaced in the list.

    Returns:
        (min(c, max_count),) errors, or (min(c, max_count), m); papers quote their mean times 1000.

    Raises:
        ValueError: a list has numbers of vertices that its surface does not have, or the lists differ in length.

    Example:
        >>> every = np.arange(len(truth))
        >>> errors = zo.geodesic_error(result, source, target_vertex=every, source_vertex=truth)
        >>> bool(errors.mean() < 0.1)
        True
    """
    check_counts(max_count=max_count)
    vertex, source = _vertex_map(surface_map), as_surface(source)
    target_vertex = vertex_numbers(target_vertex, len(vertex), "target_vertex, which comes before source_vertex,")
    source_vertex = vertex_numbers(source_vertex, len(source.vertices), "source_vertex")
    if len(target_vertex) != len(source_vertex):
        raise ValueError(
            f"There are {len(target_vertex)} target vertices and {len(source_vertex)} source vertices: give a source "
            "vertex for each target vertex."
        )
    picked = np.unique(np.linspace(0, len(target_vertex) - 1, min(max_count, len(target_vertex))).astype(int))
    image, truth = vertex[target_vertex[picked]], source_vertex[picked]
    image = vertex_numbers(image.ravel(), len(source.vertices), "Images on the source").reshape(image.shape)
    graph = edge_graph(source.vertices, source.triangles)
    error = np.empty(image.shape)
    for start in range(0, len(picked), BLOCK):
        block = slice(start, start + BLOCK)
        distance = dijkstra(graph, indices=truth[block])
        error[block] = distance[np.arange(len(distance)), image[block].T].T
    return error / np.sqrt(source.area)


def _vertex_map(given: SurfaceMap | HasMap | Integers) -> Integers:
    """(n_t,) or (n_t, m) source vertices of a map or of several."""
    given = getattr(given, "surface_map", given)
    return given.vertex if isinstance(given, SurfaceMap) else to_array(given, "A vertex map")


def distance_distortion(image: Integers, vertex: Integers, source: Surface, target: Surface) -> float:
    """Mean difference of geodesic distances between places and between their images; 0 for an isometry.

    Images and vertices (c,) correspond. Distances between sampled vertices are measured along edges (Dijkstra),
    relative to the square root of each surface's area. The triangulations alone cause differences of some thousandths.
    Places without a path between them do not count.

    Example:
        >>> from zoomout_core.evaluation import distance_distortion
        >>> distance_distortion(truth, np.arange(len(truth)), source, target) < 0.2
        True
    """
    picked, others = (np.unique(np.linspace(0, len(vertex) - 1, count).astype(int)) for count in DISTANCES)
    apart = [
        dijkstra(edge_graph(surface.vertices, surface.triangles), indices=at[picked])[:, at[others]]
        / np.sqrt(surface.area)
        for surface, at in ((target, np.asarray(vertex)), (source, np.asarray(image)))
    ]
    difference = np.abs(apart[0] - apart[1])
    return float(difference[np.isfinite(difference)].mean())


def flipped_share(surface_map: SurfaceMap, source: Surface, target: Surface) -> float:
    """The share of the target's area, in [0, 1], whose triangles the map flips, see `flipped_triangles`.

    It is 1 for a map that reverses everything, such as a mirror image.

    Example:
        >>> from zoomout_core.evaluation import flipped_share
        >>> flipped_share(result.surface_map, source, target) < 0.5
        True
    """
    area = triangle_areas(target.vertices, target.triangles)
    return float(area[flipped_triangles(surface_map, source, target)].sum() / area.sum())


def flipped_triangles(surface_map: SurfaceMap, source: Surface, target: Surface) -> Booleans:
    """(m,) which of the target's triangles the map flips.

    A triangle is flipped if its image, the triangle between its corners' images, faces against the source's normals
    there. Both surfaces count as wound outwards, however their faces are wound. A triangle that collapses to a line is
    not flipped.
    """
    normals = np.vstack([source.working.vertex_normals, np.zeros(3)])  # the extra last entry is for vertex_of = -1
    at_images = surface_map.interpolate(normals[source.working.vertex_of])
    images = surface_map.interpolate(source.vertices)
    working = target.working
    triangles = target.triangles[working.triangle_of]
    outward = np.where(working.flipped[:, None], triangles[:, [0, 2, 1]], triangles)
    found = np.zeros(len(target.triangles), dtype=bool)
    found[working.triangle_of] = folded_triangles(images, at_images, outward)
    return found


def coverage(surface_map: SurfaceMap, source: Surface) -> float:
    """The share of the source's area, in [0, 1], that the images reach.

    A face is reached if an image is in it, or in a face that shares a corner with it. An image on an edge or at a
    corner reaches the faces around that edge's ends or that corner. A target much coarser than the source cannot reach
    all of it.

    Example:
        >>> from zoomout_core.evaluation import coverage
        >>> 0.5 < coverage(result.surface_map, source) <= 1
        True
    """
    working = source.working
    corners = source.triangles[surface_map.triangle][surface_map.barycentric > 0]
    reached = np.zeros(len(working.vertices) + 1, dtype=bool)  # the extra last entry is for vertex_of = -1
    reached[working.vertex_of[corners]] = True
    area = triangle_areas(working.vertices, working.triangles)
    return float(area[reached[working.triangles].any(axis=1)].sum() / area.sum())


def edge_distortion(surface_map: SurfaceMap, source: Surface, target: Surface) -> float:
    """Mean of (image length / length - 1)^2 over the target's edges, both surfaces at unit area; 0 for an isometry.

    The image's length is the straight distance between the ends' images. Edges are weighted by squared length, so that
    slivers with their unbounded ratios do not dominate the mean.

    Example:
        >>> from zoomout_core.evaluation import edge_distortion
        >>> edge_distortion(result.surface_map, source, target) < 1
        True
    """
    edges, _ = unique_edges(target.triangles)
    images = surface_map.interpolate(source.vertices) / np.sqrt(source.area)
    length, image_length = (
        np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        for points in (target.vertices / np.sqrt(target.area), images)
    )
    return float(((image_length - length) ** 2).sum() / (length**2).sum())
