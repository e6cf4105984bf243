"""The edges of a surface as a web of strands between knots, and the target's web laid onto the source."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.cut_mesh import edge_lengths, face_edges
from zoomout_core.transfer.mapped_target import Draped

# A point of the source lies on the target if it is closer to it than so many edges, and the map is trusted there more
# than places that have no partner on the source are, see `correspondence.confidence`.
REACH = 2.0
LEAST_TRUST = 0.04


class Web:
    """The edges of a surface's faces, where vertices that coincide at borders are one.

    Attributes:
        of_edge: (e,) the strand that each edge of the surface is part of, -1 for loose edges.
        of_side: (c,) the strand that runs from each corner to the next of its face, -1 for none.
        ends: (s, 2) the knots that each strand connects, the smaller number first, in rising order.
        vertex: (k,) a vertex of the surface at each knot.
        points: (k, 3) where the knots are.
        lengths: (s,) of the strands.
    """

    def __init__(self, surface: Surface) -> None:
        knot_of = surface.working.vertex_of
        self.surface = surface
        self.vertex = np.empty(knot_of.max() + 1, dtype=np.int64)
        self.vertex[knot_of[knot_of >= 0]] = np.flatnonzero(knot_of >= 0)
        self.points: Floats = surface.vertices[self.vertex]
        of_faces = self._keys(knot_of[surface.corner_vertex[face_edges(surface)]])
        of_edges = self._keys(knot_of[surface.edges])
        keys = np.intersect1d(of_faces, of_edges)
        keys = keys[keys >= 0]
        self.ends = np.stack(np.divmod(keys, len(self.vertex)), axis=1)
        self.of_edge = self._among(keys, of_edges)
        self.of_side = self._among(keys, of_faces)
        self.lengths = edge_lengths(self.points, self.ends)

    def _keys(self, ends: Integers) -> Integers:
        """(e,) a number for each pair of knots (e, 2), -1 where these are no two."""
        low, high = ends.min(axis=1), ends.max(axis=1)
        return np.where((low >= 0) & (low < high), low * len(self.vertex) + high, -1)

    @staticmethod
    def _among(keys: Integers, wanted: Integers) -> Integers:
        place = np.searchsorted(keys, wanted)
        return np.where(np.append(keys, -2)[place] == wanted, place, -1)

    def strand_between(self, knots: Integers) -> Integers:
        """(t,) the strand that connects each pair of knots (t, 2), -1 for none."""
        return self._among(self._keys(self.ends), self._keys(knots))

    @cached_property
    def on_border(self) -> Booleans:
        """(k,) which knots are on an open border."""
        sides = np.bincount(self.of_side[self.of_side >= 0], minlength=len(self.ends))
        found = np.zeros(len(self.vertex), dtype=bool)
        found[self.ends[sides == 1]] = True
        return found

    @cached_property
    def around(self) -> tuple[Integers, Integers, Integers]:
        """Strands around knots: (k + 1,) where each knot's begin, the strands, and the knots at their other ends."""
        count = len(self.ends)
        knot = self.ends.T.ravel()
        order = np.argsort(knot, kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(knot, minlength=len(self.vertex)))])
        return start, order % count, self.ends[:, ::-1].T.ravel()[order]


class Laid:
    """The target's web, laid onto the source.

    Attributes:
        draped: the target on the source.
        web: the target's.
        points: (k, 3) where its knots lie on the source.
        edge_length: how long its strands are there, about.
    """

    def __init__(self, draped: Draped, web: Web) -> None:
        self.draped, self.web = draped, web
        self.points = draped.points[web.vertex]
        lengths = edge_lengths(self.points, web.ends)
        trusted = (draped.confidence[web.vertex] >= LEAST_TRUST)[web.ends].all(axis=1) & (lengths > 0)
        known = lengths[trusted if trusted.any() else slice(None)]
        self.edge_length = float(np.median(known)) or draped.source.working.scale
        self.scale = self.edge_length / float(np.median(web.lengths[trusted if trusted.any() else slice(None)]))


class Place(NamedTuple):
    """Where points of the source lie on the target.

    Attributes:
        knots: (q, 3) at the corners of the target's triangle.
        nearest: (q,) the nearest of these.
        distance: (q,) how far away it is, on the source.
        covered: (q,) whether the target covers the point.
    """

    knots: Integers
    nearest: Integers
    distance: Floats
    covered: Booleans


def placed(points: Floats, laid: Laid) -> Place:
    """Where points (q, 3) of the source lie on the target."""
    target, draped = laid.web.surface, laid.draped
    proper = np.flatnonzero(_proper(target))
    triangles = target.triangles[proper]
    triangle, barycentric = closest_points(points, draped.points, triangles)
    corners = triangles[triangle]
    laid_corners = draped.points[corners]
    gap = np.linalg.norm(np.einsum("qc,qcx->qx", barycentric, laid_corners) - points, axis=1)
    sides = np.linalg.norm(laid_corners - np.roll(laid_corners, 1, axis=1), axis=2)
    trust = np.einsum("qc,qc->q", barycentric, draped.confidence[corners])
    knots = target.working.vertex_of[corners]
    distance = np.linalg.norm(laid_corners - points[:, None], axis=2)
    nearest, each = np.argmin(distance, axis=1), np.arange(len(points))
    covered = (gap <= REACH * np.maximum(sides.mean(axis=1), laid.edge_length)) & (trust >= LEAST_TRUST)
    return Place(knots, knots[each, nearest], distance[each, nearest], covered)


def _proper(surface: Surface) -> Booleans:
    """(m,) which triangles have three corners apart."""
    knots = surface.working.vertex_of[surface.triangles]
    return np.asarray((knots != np.roll(knots, 1, axis=1)).all(axis=1) & (knots >= 0).all(axis=1))
