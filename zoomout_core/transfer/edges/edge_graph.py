# SPDX-License-Identifier: GPL-3.0-or-later
"""The edges of a surface as a graph, and the target's graph mapped onto the source."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths
from zoomout_core.transfer.cut_mesh import face_edges
from zoomout_core.transfer.groups import find
from zoomout_core.transfer.mapped_target import MappedTarget

# Distance from the mapped target, in edges of the target, up to which it covers a point of the source.
MAX_DISTANCE = 2.0
# Minimum confidence of the map for this; places without a partner have less, see `matching.confidence`.
MIN_CONFIDENCE = 0.04


class EdgeGraph:
    """The edges of a surface's faces, with vertices merged at coincident borders.

    Attributes:
        of_edge: (e,) the graph edge of each edge of the surface, -1 for loose edges.
        of_side: (c,) the edge of the graph from each corner to the next of its face, -1 for none.
        ends: (s, 2) the vertices that each edge of the graph connects, the smaller number first, in rising order.
        surface_vertex: (k,) a vertex of the surface at each vertex of the graph.
        points: (k, 3) positions of the vertices.
        lengths: (s,) lengths of the edges of the graph.
    """

    def __init__(self, surface: Surface) -> None:
        vertex_of = surface.working.vertex_of
        self.surface = surface
        self.surface_vertex = np.empty(vertex_of.max() + 1, dtype=np.int64)
        self.surface_vertex[vertex_of[vertex_of >= 0]] = np.flatnonzero(vertex_of >= 0)
        self.points: Floats = surface.vertices[self.surface_vertex]
        of_faces = self._keys(vertex_of[surface.corner_vertex[face_edges(surface)]])
        of_edges = self._keys(vertex_of[surface.edges])
        keys = np.intersect1d(of_faces, of_edges)
        keys = keys[keys >= 0]
        self.ends = np.stack(np.divmod(keys, len(self.surface_vertex)), axis=1)
        self.of_edge, self.of_side = find(keys, of_edges), find(keys, of_faces)
        self.lengths = edge_lengths(self.points, self.ends)

    def _keys(self, ends: Integers) -> Integers:
        """(e,) a number for each pair of vertices (e, 2), -1 if both are the same."""
        low, high = ends.min(axis=1), ends.max(axis=1)
        return np.where((low >= 0) & (low < high), low * len(self.surface_vertex) + high, -1)

    def edge_between(self, vertices: Integers) -> Integers:
        """(t,) the edge of the graph between each pair of vertices (t, 2), -1 for none."""
        return find(self._keys(self.ends), self._keys(vertices))

    @cached_property
    def on_border(self) -> Booleans:
        """(k,) which vertices are on an open border."""
        sides = np.bincount(self.of_side[self.of_side >= 0], minlength=len(self.ends))
        found = np.zeros(len(self.surface_vertex), dtype=bool)
        found[self.ends[sides == 1]] = True
        return found

    @cached_property
    def around(self) -> tuple[Integers, Integers, Integers]:
        """Edges around vertices: (k + 1,) where those of each vertex begin, the edges, and their other vertices."""
        count = len(self.ends)
        vertex = self.ends.T.ravel()
        order = np.argsort(vertex, kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=len(self.surface_vertex)))])
        return start, order % count, self.ends[:, ::-1].T.ravel()[order]


class MappedGraph:
    """The target's graph, mapped onto the source.

    Attributes:
        points: (k, 3) positions of its vertices on the source.
        edge_length: median length of its edges there.
        scale: the same relative to that on the target.
    """

    def __init__(self, mapped: MappedTarget, edge_graph: EdgeGraph) -> None:
        self.mapped, self.edge_graph = mapped, edge_graph
        self.points = mapped.points[edge_graph.surface_vertex]
        lengths = edge_lengths(self.points, edge_graph.ends)
        trusted = (mapped.confidence[edge_graph.surface_vertex] >= MIN_CONFIDENCE)[edge_graph.ends].all(axis=1)
        trusted &= lengths > 0
        if not trusted.any():
            trusted[:] = True
        self.edge_length = float(np.median(lengths[trusted])) or mapped.source.working.scale
        self.scale = self.edge_length / float(np.median(edge_graph.lengths[trusted]))


class LocatedPoints(NamedTuple):
    """The places of points of the source on the target."""

    vertices: Integers  # (q, 3) at the corners of the target's triangle
    nearest: Integers  # (q,) the nearest of these vertices
    distance: Floats  # (q,) its distance, on the source
    covered: Booleans  # (q,) whether the target covers the point


def locate_points(points: Floats, mapped_graph: MappedGraph) -> LocatedPoints:
    """Locate points (q, 3) of the source on the target."""
    target, mapped = mapped_graph.edge_graph.surface, mapped_graph.mapped
    in_graph = target.working.vertex_of[target.triangles]
    # Only triangles with three distinct corners.
    triangles = target.triangles[(in_graph != np.roll(in_graph, 1, axis=1)).all(axis=1) & (in_graph >= 0).all(axis=1)]
    triangle, barycentric = closest_points(points, mapped.points, triangles)
    corners = triangles[triangle]
    corner_points = mapped.points[corners]
    gap = np.linalg.norm(np.einsum("qc,qcx->qx", barycentric, corner_points) - points, axis=1)
    sides = np.linalg.norm(corner_points - np.roll(corner_points, 1, axis=1), axis=2)
    trust = np.einsum("qc,qc->q", barycentric, mapped.confidence[corners])
    vertices = target.working.vertex_of[corners]
    distance = np.linalg.norm(corner_points - points[:, None], axis=2)
    nearest, each = np.argmin(distance, axis=1), np.arange(len(points))
    near = gap <= MAX_DISTANCE * np.maximum(sides.mean(axis=1), mapped_graph.edge_length)
    covered = near & (trust >= MIN_CONFIDENCE)
    return LocatedPoints(vertices, vertices[each, nearest], distance[each, nearest], covered)
