# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of a target's vertices, with features that show where a map tears: places, normals, geodesic distances."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, SingleFloats, row_norms, take_rows
from zoomout_core.geometry.closest_points import search_tree
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.maps.surface_map import SurfaceMap, interpolation_matrix
from zoomout_core.matching.pair import Pair, landmark_points
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.registration.correspondences import BOUND_SAMPLES
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import at_all, edge_lengths, triangle_normals, unique_edges, vertex_areas
from zoomout_core.tuning import Tuning, tuned

# Number of edges in a block of comparisons, which fits into the processor's cache.
EDGES = 1 << 12
# Differences of geodesic distances, at unit area, that do not matter.
LEVEL = 1e-3
# Samples of each triangle, on average, that are enough on coarse sources.
SAMPLES_OF_TRIANGLE = 20


@dataclass(frozen=True)
class ImageTuning(Tuning, set_by="everywhere"):
    """The points of the source that images are projected to."""

    samples: int = tuned(120_000, "points", 1, 10_000_000)  # of the source to project to, or all its triangles
    normal_weight: float = tuned(0.02, "at unit area", 0, 10)  # distance that equals a unit difference of normals


IMAGES = ImageTuning()


class Images(NamedTuple):
    """The images of the working vertices of a target."""

    triangle: Integers  # (n,) of the source's working mesh
    barycentric: Floats  # (n, 3)
    features: SingleFloats  # (n, 6 + d) positions, normals, and geodesic distances to some samples, at unit area

    def at(self, vertices: Integers) -> Images:
        """The images of some vertices (q,)."""
        return Images(self.triangle[vertices], self.barycentric[vertices], take_rows(self.features, vertices))

    def replace_at(self, vertices: Integers, by: Images) -> None:
        """Replace the images of some vertices (q,), in place."""
        self.triangle[vertices], self.barycentric[vertices], self.features[vertices] = by


class PairMeshes:
    """The working meshes of a pair, prepared once to fill in any of its maps."""

    def __init__(self, pair: Pair, has_partner: Booleans | None = None) -> None:
        self.source, self.target = pair.source.working, pair.target.working
        # (n_s, 6 + d) the features of the source's vertices, see `Images`.
        places = self.source.vertices, self.source.vertex_normals, _marks(pair.source, pair.source_shape)
        self.features: SingleFloats = np.hstack([each.astype(np.float32) for each in places])
        # (m_surface,) the working triangle of each triangle of the source's surface.
        self.triangle_number = np.zeros(len(pair.source.triangles), dtype=np.int64)
        self.triangle_number[self.source.triangle_of] = np.arange(len(self.source.triangles))
        known = np.ones(len(self.target.vertices), dtype=bool)
        if has_partner is not None:
            known[self.target.vertex_of[self.target.vertex_of >= 0]] = has_partner[self.target.vertex_of >= 0]
        self.edges, _ = unique_edges(self.target.triangles)  # (e, 2) of the target
        self.known = at_all(known, self.edges)  # (e,) which of them join vertices with a partner, and can be torn
        self.length = edge_lengths(self.target.vertices, self.edges)  # (e,)
        self.areas = vertex_areas(self.target.vertices, self.target.triangles) * known  # (n,) of vertices with one
        self.fixed = np.zeros(len(self.areas), dtype=bool)  # (n,) vertices at exact landmarks
        if pair.exact_landmarks is not None:
            used = np.flatnonzero(self.target.vertex_of >= 0)
            points = landmark_points(pair, pair.exact_landmarks)[1]
            near = cKDTree(pair.target.vertices[used]).query(points)[1]
            self.fixed[self.target.vertex_of[used[near]]] = True

    def images_by(self, surface_map: SurfaceMap, vertices: Integers | slice = slice(None)) -> Images:
        """The images of some working vertices of the target by a map of its surface."""
        member = self.target.surface_vertex[vertices]
        return self.images(self.triangle_number[surface_map.triangle[member]], surface_map.barycentric[member])

    def images(self, triangle: Integers, barycentric: Floats) -> Images:
        """Images by their triangles (q,) and barycentric coordinates (q, 3), with their features."""
        weights = interpolation_matrix(
            take_rows(self.source.triangles, triangle), barycentric.astype(np.float32), len(self.features)
        )
        return Images(triangle, barycentric, np.asarray(weights @ self.features))

    @cached_property
    def graph(self) -> csr_array:
        """(n, n) adjacency of the target's vertices."""
        ends = np.concatenate([self.edges, self.edges[:, ::-1]])
        return csr_array((np.ones(len(ends)), ends.T), shape=(len(self.areas), len(self.areas)))

    @cached_property
    def samples(self) -> tuple[cKDTree, Integers]:
        """A search tree of samples of the source with their normals, and (c,) the triangle of each."""
        source = self.source
        count = len(source.triangles) * SAMPLES_OF_TRIANGLE
        count = max(min(count, IMAGES.samples), len(source.triangles))
        points, on = surface_samples(source.vertices, source.triangles, count)
        normals = triangle_normals(source.vertices, source.oriented_triangles)[on]
        places = np.hstack([points, IMAGES.normal_weight * normals])
        return search_tree(places), on


def image_lengths(features: SingleFloats, edges: Integers) -> Floats:
    """(e,) lengths of the images of edges (e, 2), in space or along the surface, from their features (n, 6 + d)."""
    length = np.empty(len(edges))
    for first in range(0, len(edges), EDGES):
        some = edges[first : first + EDGES]
        apart = take_rows(features, some[:, 0]) - take_rows(features, some[:, 1])
        space = row_norms(apart[:, :3])
        length[first : first + EDGES] = np.maximum(space, np.abs(apart[:, 6:]).max(axis=1))
    return length


def _marks(source: Surface, shape: ShapeAnalysis) -> Floats:
    """(n, d) geodesic distances from some samples of a shape to the working vertices of its surface.

    The largest difference of two rows bounds the geodesic distance from below. Distances on a hull distinguish neither
    the two sides of a wing nor touching parts. On a hull all are zero, and edges are judged by their lengths in space.
    """
    working, body = source.working, shape.proxy.full
    if body.is_hull:
        return np.zeros((len(working.vertices), 1))
    of_body = np.full(len(working.vertices), -1)
    used = working.vertex_of >= 0
    of_body[working.vertex_of[used]] = body.vertex_of[used]
    beside = np.flatnonzero(of_body < 0)
    if len(beside):  # loose parts are where the body is next to them
        places = body.from_surface(working.to_surface(working.vertices[beside]))
        of_body[beside] = cKDTree(body.vertices).query(places)[1]
    place = shape.proxy.place
    at_vertices = SurfaceMap(place.triangle[of_body], place.barycentric[of_body], place.source_triangles)
    marks = at_vertices.interpolate(shape.distances[:BOUND_SAMPLES].T)
    if len(beside):
        edges, _ = unique_edges(working.triangles)
        _level(marks, edges[np.isin(edges[:, 0], beside)], working.vertices)
    return marks


def _level(marks: Floats, edges: Integers, vertices: Floats) -> None:
    """Lower marks (n, d) until they differ along edges (e, 2) by no more than the length, as geodesic distances do.

    Next to a loose part, the body may end and begin again, as a torso and an arm beside a coat. Changes begin at such
    places and spread from vertex to vertex.
    """
    lengths = edge_lengths(vertices, edges)
    steps = [
        np.abs(marks[some[:, 0]] - marks[some[:, 1]]).max(axis=1)
        for some in np.split(edges, range(EDGES, len(edges), EDGES))
    ]
    changed = np.unique(edges[np.concatenate(steps) > lengths + LEVEL])
    both = np.concatenate([edges, edges[:, ::-1]])
    graph = csr_array((np.tile(lengths, 2), both.T), shape=(len(marks), len(marks)))
    while len(changed):
        around = graph[changed].tocoo()
        order = np.argsort(around.col, kind="stable")
        reached, first = np.unique(around.col[order], return_index=True)
        offers = marks[changed[around.row[order]]] + around.data[order, None]
        lower = np.minimum.reduceat(offers, first)
        is_lower = (lower < marks[reached] - LEVEL).any(axis=1)
        changed = reached[is_lower]
        marks[changed] = np.minimum(marks[changed], lower[is_lower])
